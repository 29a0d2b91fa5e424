"""Impossible runs are refused with memory and time, long ones warned of."""

import pytest

import slipperjax as sj
from slipperjax.tools.limits import available_memory, refuse_impossible, shown_bytes, shown_time


def test_durations_and_sizes_in_words():
    durations = {
        0.2: "0.2 s",
        100: "100 s",
        125: "2.08 min",
        12_000: "3.33 h",
        3e5: "3.47 days",
        6e8: "19 years",
    }
    assert {seconds: shown_time(seconds) for seconds in durations} == durations
    assert [shown_bytes(x) for x in (999.0, 2.5e9, 8e12, 3e18)] == ["999 B", "2.5 GB", "8 TB", "3e+03 PB"]


def test_memory_and_time_decide(monkeypatch):
    monkeypatch.setattr("slipperjax.tools.limits.available_memory", lambda: 10**9)
    refuse_impossible("Two cases", 1e9, 3600.0)
    with pytest.raises(ValueError, match="Two cases need about 2 GB of memory and 60 min, but 1 GB of memory are"):
        refuse_impossible("Two cases", 2e9, 3600.0)
    with pytest.raises(ValueError, match=r"and 3\.17 years, which is more than a year"):
        refuse_impossible("Two cases", 1e3, 1e8)
    with pytest.warns(sj.ImplausibleWarning, match="Two cases need about 1 kB of memory and 3.47 days"):
        refuse_impossible("Two cases", 1e3, 3e5)
    monkeypatch.setattr("slipperjax.tools.limits.available_memory", lambda: None)
    refuse_impossible("Two cases", 1e30, 3600.0)


@pytest.mark.parametrize(
    ("group", "files", "free"),
    [
        # of the second version: a limit, and one below it from which on a process is slowed down
        ("0::/job", {"job": {"memory.max": "max", "memory.high": "900000", "memory.current": "400000"}}, 550_000),
        # a container sees its own group as the base, whatever its path is outside
        ("0::/docker/1", {"": {"memory.max": "600000", "memory.current": "100000"}}, 550_000),
        # the limit of a group around it
        (
            "0::/user/job",
            {
                "user": {"memory.max": "500000", "memory.current": "450000"},
                "user/job": {"memory.max": "max", "memory.current": "1"},
            },
            100_000,
        ),
        # of the first version
        (
            "4:cpu,memory:/job",
            {"memory/job": {"memory.limit_in_bytes": "300000", "memory.usage_in_bytes": "100000"}},
            250_000,
        ),
        ("3:cpu:/job", {"job": {"memory.max": "1", "memory.current": "1"}}, 1_024_000),
        ("0::/", {"": {"memory.max": "max", "memory.current": "400000"}}, 1_024_000),
        ("0::/job", {"job": {"memory.max": "1000", "memory.current": "400000"}}, 0),
    ],
)
def test_the_limit_of_a_container_counts(group, files, free, tmp_path):
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/meminfo").write_text("MemTotal: 4000 kB\nMemAvailable: 1000 kB\n")
    (tmp_path / "proc/self/cgroup").write_text(f"7:pids:/job\n{group}\n")
    for folder, content in files.items():
        place = tmp_path / "sys/fs/cgroup" / folder
        place.mkdir(parents=True, exist_ok=True)
        # files in the cache give way
        cache = "total_inactive_file" if folder.startswith("memory") else "inactive_file"
        for name, text in {"memory.stat": f"anon 1\n{cache} 50000", **content}.items():
            (place / name).write_text(f"{text}\n")
    assert available_memory(tmp_path) == free
