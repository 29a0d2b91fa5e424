"""Progress bars say which program is compiled, and are shown where somebody looks at them."""

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context

import jax
import jax.numpy as jnp
import pytest

from slipperjax.tools.compile import jit
from slipperjax.tools.notices import CompileNotices
from slipperjax.tools.one_kernel import in_one_kernel
from slipperjax.tools.progress import bar

PROGRESS = sys.modules[bar.__module__]


def program(factor: float):
    """A program of its own that steps, which is compiled at its first call."""
    step = lambda x, _: (factor * x, None)
    steps = lambda x: jax.lax.scan(step, x, None, 3)[0]
    return jit(lambda x: in_one_kernel(lambda x: steps(in_one_kernel(steps, x)), x))


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)


@pytest.fixture
def shown(capsys):
    return lambda: [line.strip() for line in capsys.readouterr().err.replace("\r", "\n").split("\n")]


def test_programs_that_step_are_told_while_they_are_compiled(terminal, shown):
    one, other = program(2.0), program(3.0)
    with bar(True, programs=2, desc="branch") as progress:
        jit(lambda x: x + 1)(jnp.ones(()))  # a small one
        assert not any("compiling" in line for line in shown())
        assert float(one(jnp.ones(()))) == 2.0**6
        first = shown()
        one(jnp.ones(()))  # it is there
        assert not any("compiling" in line for line in shown())
        other(jnp.ones(())), program(5.0)(jnp.ones(()))
        progress.update()
    lines = first + shown()
    texts = [line.split(":")[0] for line in lines if "compiling" in line]
    assert texts == [f"branch, compiling program {of}" for of in ("1 of 2", "2 of 2", "3 of 3")]
    assert lines[-2].startswith("branch: 1it")


def test_threads_of_a_run_tell_it_too(terminal, shown):
    with bar(True, desc="sweep"):
        call = lambda: program(7.0)(jnp.ones(()))
        thread = threading.Thread(target=copy_context().run, args=(call,))
        thread.start()
        thread.join()
    assert any("sweep, compiling program 1 of 1" in line for line in shown())


def test_of_programs_that_are_compiled_at_once_the_next_one_is_told():
    texts = []
    notices = CompileNotices(2, texts.append)
    with ThreadPoolExecutor(1) as other:
        notices.begin()
        other.submit(notices.begin).result()
        other.submit(notices.end).result()
        notices.end()
    assert texts == [*["compiling program 1 of 2"] * 2, "compiling program 2 of 2", ""]


def test_a_program_that_fails_is_told_no_longer(terminal, shown):
    def fails(x):
        in_one_kernel(jnp.sin, x)
        raise RuntimeError("no program")

    with bar(True, desc="sweep"), pytest.raises(RuntimeError, match="no program"):
        jit(fails)(jnp.ones(()))
    assert shown()[-2].startswith("sweep: 0it")


def test_a_bar_within_another_one_leaves_it_the_word(terminal, shown):
    with bar(True, desc="outer"), bar(False, desc="inner"):
        program(11.0)(jnp.ones(()))
    lines = shown()
    assert any("outer, compiling" in line for line in lines)
    assert not any("inner" in line for line in lines)


@pytest.mark.parametrize("wanted", [True, False])
def test_other_work_begins_with_the_first_program(terminal, capsys, wanted):
    begun, one = [], program(19.0)
    with bar(wanted, meanwhile=lambda: begun.append(1), desc="once"):
        jit(lambda x: x + 3)(jnp.ones(()))
        assert begun == []
        one(jnp.ones(())), program(23.0)(jnp.ones(()))
    with bar(wanted, meanwhile=lambda: begun.append(2), desc="again"):
        one(jnp.ones(()))
    assert begun == [1]
    assert ("once" in capsys.readouterr().err) == wanted


def test_by_default_a_bar_is_on_terminals_and_goes(capsys, monkeypatch):
    with bar(None, desc="piped"):
        program(13.0)(jnp.ones(()))
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with bar(None, desc="short") as progress:
        progress.update()
    assert "short" not in capsys.readouterr().err
    with bar(None, desc="long"):
        program(17.0)(jnp.ones(()))
    text = capsys.readouterr().err
    assert "long, compiling program 1 of 1" in text
    assert text.endswith(" \r")  # wiped out


def test_files_get_lines_where_nothing_is_done(shown, monkeypatch):
    monkeypatch.setattr(PROGRESS, "LONGEST_SILENCE", 0.1)
    threads = threading.active_count()
    lines = []
    until = time.monotonic() + 60.0
    with bar(True, desc="compiling"):
        while len(lines) < 4 and time.monotonic() < until:
            time.sleep(0.02)
            lines += [line for line in shown() if line]
    assert all(line.startswith("compiling: 0it") for line in lines)
    assert len(lines) >= 4
    assert threading.active_count() == threads


@pytest.mark.parametrize("wrong", ["yes", 1, jnp.ones(3)])
def test_other_wishes_are_refused(wrong):
    with pytest.raises(ValueError, match="Argument `progress` must be True or False"), bar(wrong):
        pass
