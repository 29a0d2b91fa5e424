"""The plain form of the tricks for speed: when it is chosen, and that its numbers are the same."""

import os
import subprocess
import sys
import types

import jax
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.flow.period_map import PeriodMap
from slipperjax.tools import fast, forms, plain, self_test
from slipperjax.tools.cache import keep_in
from slipperjax.tools.compile import jit


@pytest.fixture
def undecided(monkeypatch):
    """A process that has not chosen its form yet."""
    monkeypatch.delenv("SLIPPERJAX_PLAIN", raising=False)
    monkeypatch.setattr(forms._Choice, "form", None)


@pytest.mark.usefixtures("undecided")
def test_the_self_test_passes_with_this_version_of_jax():
    assert self_test.fault() == ""
    assert not forms.is_plain()


@pytest.mark.usefixtures("undecided")
@pytest.mark.parametrize(("value", "is_plain"), [("0", False), ("1", True)])
def test_the_environment_chooses_the_plain_form(value, is_plain, monkeypatch, recwarn):
    monkeypatch.setenv("SLIPPERJAX_PLAIN", value)
    monkeypatch.setattr(self_test, "fault", lambda: "")
    assert forms.is_plain() == is_plain
    assert forms.is_plain() == is_plain
    texts = [str(w.message) for w in recwarn]
    assert len(texts) == is_plain  # one warning, not one a call
    assert all("times slower" in text and "SLIPPERJAX_PLAIN" in text for text in texts)


@pytest.mark.usefixtures("undecided")
def test_another_value_in_the_environment_is_one_clear_error(monkeypatch):
    monkeypatch.setenv("SLIPPERJAX_PLAIN", "yes")
    with pytest.raises(ValueError, match="SLIPPERJAX_PLAIN must be 0 or 1, but is 'yes'"):
        forms.is_plain()


@pytest.mark.full
@pytest.mark.usefixtures("undecided")
@pytest.mark.parametrize("name", ["sums", "circle", "store", "in_one_kernel"])
def test_a_trick_that_gives_wrong_numbers_is_found(name, monkeypatch):
    right = getattr(fast, name)
    wrong = lambda *args: jax.tree.map(lambda x: 1.001 * x, right(*args))
    monkeypatch.setattr(fast, name, wrong)
    monkeypatch.setattr(self_test, "_file", lambda: None)
    with pytest.warns(forms.PlainWarning, match="wrong numbers"):
        assert forms.is_plain()


@pytest.mark.usefixtures("undecided")
def test_a_name_that_jax_no_longer_has_is_a_fault_and_no_traceback(monkeypatch):
    monkeypatch.setitem(sys.modules, "slipperjax.tools.fast", None)  # an import of it is an ImportError
    monkeypatch.delattr("slipperjax.tools.fast")
    with pytest.warns(forms.PlainWarning, match="self-test of the fast form fails"):
        assert forms.is_plain()


def test_the_file_of_a_self_test_is_for_one_version(monkeypatch, tmp_path, own_cache):
    keep_in(tmp_path)
    file = self_test._file()
    assert file.parent == tmp_path
    monkeypatch.setattr(jax, "__version__", "0.99")
    assert self_test._file() != file
    file.write_bytes(self_test.PASSED)
    monkeypatch.undo()
    keep_in(tmp_path)
    monkeypatch.setattr(self_test, "_computed", lambda: pytest.fail("the self-test runs again"))
    assert self_test.fault() == ""


def broken(error):
    """The fast forms, of which the kernel cannot be compiled."""

    def in_one_kernel(fun, *args):
        raise error

    module = types.ModuleType("broken")
    vars(module).update({name: getattr(fast, name) for name in fast.__all__}, in_one_kernel=in_one_kernel)
    return module


@pytest.mark.parametrize(
    "error", [NotImplementedError("no rule"), jax.errors.JaxRuntimeError("UNIMPLEMENTED: Fusion kind")]
)
def test_a_program_that_jax_cannot_compile_is_compiled_in_the_plain_form(error, monkeypatch):
    monkeypatch.setattr(forms._Choice, "form", broken(error))
    monkeypatch.setattr(jax, "clear_caches", lambda: None)  # the other tests' programs stay
    doubled = jit(lambda x: forms.in_one_kernel(lambda x: 2 * x, x))
    with pytest.warns(forms.PlainWarning, match=rf"cannot compile a program: .*{str(error).partition(':')[0]}"):
        assert float(doubled(1.5)) == 3.0
    assert forms.is_plain()


@pytest.mark.parametrize("error", [jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: memory"), ValueError("mine")])
def test_other_errors_are_left_as_they_are(error, monkeypatch):
    monkeypatch.setattr(forms._Choice, "form", broken(error))
    with pytest.raises(type(error), match=str(error)):
        jit(lambda x: forms.in_one_kernel(lambda x: 2 * x, x))(1.5)
    assert not forms.is_plain()


def test_both_forms_have_the_same_functions():
    public = {name for name in vars(forms) if not name.startswith("_")}
    assert set(fast.__all__) <= public
    assert all(hasattr(plain, name) for name in fast.__all__)


@pytest.mark.full
def test_a_period_and_its_derivative_are_the_same_in_both_forms(monkeypatch):
    scene = sj.paper_scene()
    state = sj.initial_state(scene, sj.table_2_start())
    found = {}
    for form in (fast, plain):
        monkeypatch.setattr(forms._Choice, "form", form)
        # a function of its own for each form, because JAX keeps what it has traced
        end = lambda speed, form=form: PeriodMap(scene.replace(speed=speed), 20, sj.solvers.RK4())(state).motion.v_z
        found[form] = jax.jit(lambda speed, end=end: jax.jvp(end, (speed,), (1.0,)))(1250.0)
    np.testing.assert_allclose(found[plain], found[fast], rtol=1e-10)  # measured: 3e-14


@pytest.mark.full
def test_a_command_in_the_plain_form_warns_once(tmp_path):
    code = "import slipperjax_command; slipperjax_command.main()"
    options = ["--no-cache", "simulate", "--periods", "1", "--probe", "0", "--out", str(tmp_path / "run")]
    environment = os.environ | {"SLIPPERJAX_PLAIN": "1"}
    done = subprocess.run([sys.executable, "-c", code, *options], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr[-300:]
    assert done.stderr.count("plain form") == 1
