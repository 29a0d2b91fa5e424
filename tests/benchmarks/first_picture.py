"""A command in this process, with its time split into parts [s], printed as JSON: see test_first_picture.py."""

import json
import time

begin = time.perf_counter()
import jax  # noqa: E402

import slipperjax.cli as cli  # noqa: E402

PARTS = {
    "jaxpr_trace_duration": "trace",
    "jaxpr_to_mlir_module_duration": "trace",
    "backend_compile_duration": "compile",
}


def union(intervals: list[tuple[float, float]]) -> float:
    """Seconds covered by intervals, which nest where a program is traced inside another one."""
    total, until = 0.0, 0.0
    for start, end in sorted(intervals):
        total += max(end - max(start, until), 0.0)
        until = max(until, end)
    return total


def main() -> None:
    """Runs the command of this process's arguments, and prints the parts of its time."""
    imported = time.perf_counter()
    spans: dict[str, list[tuple[float, float]]] = {"trace": [], "compile": []}
    programs = []

    def heard(name: str, seconds: float, **_) -> None:
        part = PARTS.get(name.rpartition("/")[2])
        if part is not None:
            now = time.perf_counter()
            spans[part].append((now - seconds, now))
            programs.append(part)

    written = []
    jax.monitoring.register_event_duration_secs_listener(heard)
    from slipperjax.cli import files

    original = files.Outputs.write

    def write(self, *args, **options):
        start = time.perf_counter()
        text = original(self, *args, **options)
        written.append((start, time.perf_counter()))
        return text

    files.Outputs.write = write
    try:
        cli.main()
    except SystemExit as done:
        if done.code:
            raise
    end = time.perf_counter()
    parts = {"import": imported - begin}
    counted, everything = [], 0.0
    # threads trace while others compile: such a time counts once, so that the parts add up to all
    for name, of in (spans | {"write": written}).items():
        counted += of
        parts[name] = union(counted) - everything
        everything = union(counted)
    parts["run and the rest"] = end - imported - everything
    parts["all"] = end - begin
    print("ROW " + json.dumps(parts | {"programs": programs.count("compile")}))


if __name__ == "__main__":
    main()
