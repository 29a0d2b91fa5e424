"""Modes in files: what finite elements give is read by the names of mounts, and what is wrong is told."""

import sys

import numpy as np
import pytest

import slipperjax as sj

NAMES = ["left1", "left2", "Right_front"]
SHAPES = np.arange(18.0).reshape(2, 3, 3) / 100
ARRAYS = {"frequency": [50.0, 80.0], "damping": [0.01, 0.02], "shapes": SHAPES}


def table(tmp_path, *changes):
    """Writes a table of two modes, with texts replaced."""
    head = ", ".join(f"{name} {axis}" for name in NAMES for axis in "xyz")
    rows = [", ".join(map(str, row)) for row in SHAPES.reshape(2, 9)]
    text = f"frequency [kHz], damping, {head}\n0.05, 0.01, {rows[0]}\n0.08, 0.02, {rows[1]}\n"
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "fe.csv"
    file.write_text(text)
    return file


def arrays(tmp_path, **changes):
    """Writes arrays of two modes, with some replaced, or left out where they are None."""
    file = tmp_path / "fe.npz"
    np.savez(file, **{name: array for name, array in (ARRAYS | changes).items() if array is not None})
    return file


@pytest.mark.parametrize("made", [table, lambda folder: arrays(folder, mounts=NAMES)])
def test_shapes_are_found_by_the_names_of_mounts(made, tmp_path):
    file = made(tmp_path)
    for mounts, order in ((None, [0, 1, 2]), (NAMES[::-1], [2, 1, 0])):
        modes = sj.model.load_modes(file, mounts)
        np.testing.assert_allclose(modes.frequency, ARRAYS["frequency"], rtol=1e-15)
        np.testing.assert_array_equal(modes.damping, ARRAYS["damping"])
        np.testing.assert_array_equal(modes.shapes, SHAPES[:, order])


def test_shapes_along_the_rail_may_be_left_out(tmp_path):
    rows = [", ".join(map(str, row.ravel())) for row in SHAPES[..., 1:]]
    head = ", ".join(f"{name} {axis}" for name in NAMES for axis in "yz")
    file = tmp_path / "fe.csv"
    file.write_text(f"frequency [Hz], damping, {head}\n50, 0.01, {rows[0]}\n80, 0.02, {rows[1]}\n")
    np.testing.assert_array_equal(sj.model.load_modes(file, NAMES).shapes, SHAPES[..., 1:])
    file = arrays(tmp_path, mounts=NAMES, shapes=SHAPES[..., 1:])
    np.testing.assert_array_equal(sj.model.load_modes(file, NAMES).shapes, SHAPES[..., 1:])
    with pytest.raises(ValueError, match=r"`shapes` must be along y and z, or x, y and z, but is shape \(2, 3, 1\)"):
        sj.model.Modes(**ARRAYS | {"shapes": SHAPES[..., 2:]})


def test_other_units_of_mass_and_places_besides_the_mounts(tmp_path):
    # a modal mass of one tonne
    modes = sj.model.load_modes(table(tmp_path, ("left2 z", "left2 z [tonne^-0.5]")))
    np.testing.assert_allclose(modes.shapes[:, 1, 2], SHAPES[:, 1, 2] / np.sqrt(1000), rtol=1e-15)
    np.testing.assert_array_equal(modes.shapes[:, 0], SHAPES[:, 0])
    places = {"places": [[0.5, 0.0, 0.4]], "place_shapes": np.ones((2, 1, 3))}
    modes = sj.model.load_modes(arrays(tmp_path, **places), NAMES)
    for name, array in places.items():
        np.testing.assert_array_equal(getattr(modes, name), array)


FAULTS = [
    (table, [("left2 y", "left2 u")], "fe.csv: must have the shapes x, y and z of left2, as in left1 y"),
    (table, [("damping", "zeta")], "fe.csv: must have a column damping"),
    (table, [("0.08,", "0.04,")], "fe.csv, line 3: frequency 0.04 is below that of the mode before"),
    (table, [("0.01,", "-0.01,")], "fe.csv: Argument `damping` must be zero or positive"),
    (table, [("0.08,", "0.04,"), (" 0.02, 0.09", " x, 0.09")], "fe.csv has 2 faults"),
    (arrays, {"mounts": ["left1", "left2", "right"]}, "`shapes` must have those at Right_front, but has those at"),
    (arrays, {"shapes": SHAPES[:, :2]}, r"`shapes` must be of shape (modes, 3, 3), but is of shape (2, 2, 3)"),
    (arrays, {"frequency": [80.0, 50.0]}, "`frequency` must rise from mode to mode"),
    (arrays, {"damping": [0.01]}, "`damping` must have one value per mode"),
    (arrays, {"damping": None}, "must have arrays frequency, damping and shapes, but has no damping"),
    (arrays, {"shapes": np.array([{}], object)}, "is no npz file that can be read"),
]


@pytest.mark.parametrize(("make", "changes", "words"), FAULTS)
@pytest.mark.filterwarnings("ignore:File .* has columns that are not read")
def test_faults_of_files_are_told(make, changes, words, tmp_path):
    file = table(tmp_path, *changes) if make is table else arrays(tmp_path, **changes)
    with pytest.raises(ValueError, match=file.name) as caught:
        sj.model.load_modes(file, NAMES)
    assert words in str(caught.value)
    if make is arrays:
        assert "\n" not in str(caught.value)
        assert str(caught.value).count(file.name) == 1


def test_what_is_no_file_of_modes_is_told(tmp_path):
    (tmp_path / "fe.npz").write_bytes(b"PK\x03\x04")
    with pytest.raises(ValueError, match=r"^\S+fe\.npz is no npz file that can be read"):
        sj.model.load_modes(tmp_path / "fe.npz")
    with pytest.raises(FileNotFoundError, match=r"No such file: .*none\.csv"):
        sj.model.load_modes(tmp_path / "none.csv")
    with pytest.raises(ValueError, match="`mounts` must be a list of names"):
        sj.model.load_modes(tmp_path / "fe.npz", "left1")


def test_shapes_of_another_scale_are_divided_by_their_masses_or_warned_of(tmp_path):
    masses = [4.0, 25.0]
    scale = np.sqrt(masses)[:, None, None]
    file = arrays(tmp_path, mounts=NAMES, modal_mass=masses)
    np.testing.assert_allclose(sj.model.load_modes(file).shapes, SHAPES / scale, rtol=1e-15)
    text = table(tmp_path, ("damping,", "damping, modal mass [kg],"), (" 0.01, 0.0, ", " 0.01, 4, 0.0, "))
    text.write_text(text.read_text().replace(" 0.02, 0.09", " 0.02, 25, 0.09"))
    np.testing.assert_allclose(sj.model.load_modes(text).shapes, SHAPES / scale, rtol=1e-15)
    with pytest.raises(ValueError, match=r"fe\.npz: Argument `modal_mass` must be positive, but is -1 kg"):
        sj.model.load_modes(arrays(tmp_path, modal_mass=[4.0, -1.0]))
    with pytest.raises(ValueError, match="`modal_mass` must have one value per mode, 2, but has shape"):
        sj.model.load_modes(arrays(tmp_path, modal_mass=[4.0]))
    # a beam of 500 kg, as finite elements write it: with a largest value of 1
    mounts = [sj.Mount(x=x, name=name) for x, name in ((2.0, "a"), (-2.0, "b"))]
    beam = sj.model.Modes.beam([2.0, -2.0], mass=500.0, length=4.0, stiffness=1e7)
    sled = lambda modes: sj.Sled(mass=500.0, inertia=(50, 700, 700), mounts=mounts, length=0.2, modes=modes)
    sled(beam)
    largest = np.abs(beam.shapes).max(axis=(1, 2), keepdims=True)
    with pytest.warns(sj.ImplausibleWarning, match="square times the sled's mass is 500; plausible is up to 30"):
        sled(sj.model.Modes(frequency=beam.frequency, damping=beam.damping, shapes=beam.shapes / largest))


UNIVERSAL = """    -1
    55
a beam
none
none
none
none
         1         2         3         8         2         6
         2         4         1         {k}
  {frequency}  {mass}  1.00000e-02  0.00000e+00
        12
  1.00000e-01  2.00000e-01  3.00000e-01  0.00000e+00  0.00000e+00  0.00000e+00
        15
  0.00000e+00  4.00000e-01 -1.00000e+00  0.00000e+00  0.00000e+00  0.00000e+00
    -1
"""


def test_universal_files_have_modes_with_their_masses(tmp_path, monkeypatch):
    file = tmp_path / "beam.unv"
    parts = [(1, "2.00000e+01", "4.00000e+00"), (2, "5.00000e+01", "2.50000e+01")]
    file.write_text("".join(UNIVERSAL.format(k=k, frequency=f, mass=mass) for k, f, mass in parts))
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "pyuff", None)
        with pytest.raises(ValueError, match=r"beam\.unv: universal files need pyuff"):
            sj.model.load_modes(file)
    pytest.importorskip("pyuff")
    modes = sj.model.load_modes(file, ["15", "12"])
    np.testing.assert_allclose(modes.frequency, [20.0, 50.0])
    shapes = np.array([[0.0, 0.4, -1.0], [0.1, 0.2, 0.3]])
    np.testing.assert_allclose(modes.shapes, shapes / np.array([2.0, 5.0])[:, None, None])
    with pytest.raises(ValueError, match="`shapes` must have those at 13, but has those at 12 and 15"):
        sj.model.load_modes(file, ["13"])
    file.write_text("no universal file")
    with pytest.raises(ValueError, match=r"beam\.unv"):
        sj.model.load_modes(file)
