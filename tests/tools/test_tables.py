"""Tables in files: all faults at once, in the file's units, and columns that nobody asked for."""

import warnings

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.tools.tables import MOST_SHOWN, Table, TableError

WANTED = {"distance": "m", "height": "m", "share": ""}
ALIASES = {"chainage": "distance"}
COUNT = 40


def rows(change=lambda row, k: row):
    """Lines of a survey in feet, with columns of words."""
    made = ([f"{1000 + k}", f"{k % 7}.5", "J" if k % 13 == 0 else "", "21.5"] for k in range(COUNT))
    return [
        "Chainage [ft], Height [mm], Joint, Air [degC]",
        *(",".join(change(row, k)) for k, row in enumerate(made)),
    ]


def table(tmp_path, lines, name="table.csv"):
    content = "\n".join(lines).encode()
    (tmp_path / name).write_bytes(content)
    return Table(tmp_path / name, content, WANTED, ALIASES)


def read(tmp_path, lines, **options):
    found = table(tmp_path, lines)
    found.check_rising("distance", **options)
    return found.si()


def test_columns_of_words_and_others_are_left_out_with_one_warning(tmp_path):
    with pytest.warns(sj.ImplausibleWarning, match=r"csv has columns that are not read: Joint and Air\.$") as told:
        found = read(tmp_path, rows())
    assert len(told) == 1
    np.testing.assert_allclose(found["distance"], (1000 + np.arange(COUNT)) * 0.3048, rtol=1e-15)
    np.testing.assert_allclose(found["height"], (np.arange(COUNT) % 7 + 0.5) * 1e-3, rtol=1e-15)
    assert set(found) == {"distance", "height"}
    # what is not wanted may be left out at the end of a row, also by spreadsheets that add empty rows
    short = rows(lambda row, k: row[:2] if k % 2 else row)
    with pytest.warns(sj.ImplausibleWarning):
        np.testing.assert_array_equal(read(tmp_path, [*short, ",,,", ""])["height"], found["height"])


def test_units_below_and_pure_numbers(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read(tmp_path, ["distance;share;height", "ft;;m", "1,5;0,25;2", "2,5;0,5;3"])
        alone = read(tmp_path, ["distance [km], share", "1.5, 0.25", "2.5, 0.5"])
    np.testing.assert_allclose(found["distance"], [1.5 * 0.3048, 2.5 * 0.3048], rtol=1e-15)
    np.testing.assert_array_equal(found["share"], [0.25, 0.5])
    np.testing.assert_array_equal(alone["distance"], [1500.0, 2500.0])


def test_names_are_of_one_word_or_several(tmp_path):
    """Joined by spaces or underscores, in any letters; a function may choose by them what is wanted."""
    of_two = {"distance": "m", "left_height": "m", "right_height": "m"}
    seen = []

    def wanted(names):
        seen.append(set(names))
        return of_two if "right_height" in names else WANTED

    for head in ("left height [mm], Right  Height [mm]", "LEFT_HEIGHT [mm], right_height [mm]"):
        content = f"written in spring, left height\nchainage [m], {head}\n1, 2, 3\n2, 4, 5".encode()
        found = Table(tmp_path / "table.csv", content, wanted, ALIASES)
        assert seen[-1] == set(of_two)
        np.testing.assert_allclose(found.si()["right_height"], [3e-3, 5e-3], rtol=1e-15)
        assert set(found.columns) == set(of_two)
    assert found.columns["left_height"].name == "LEFT_HEIGHT"
    alone = Table(tmp_path / "table.csv", b"distance [m], height [mm]\n1, 2\n2, 4", wanted, ALIASES)
    assert set(alone.si()) == {"distance", "height"}


FAULTS = {
    3: (lambda row: [row[0], "", *row[2:]], "`Height` has no number."),
    8: (lambda row: ["1006", *row[1:]], "Chainage 1006 ft does not exceed 1006 ft of line 8."),
    9: (lambda row: ["1001", *row[1:]], "Chainage 1001 ft does not exceed 1006 ft of line 9."),
    20: (lambda row: [row[0], "loose", *row[2:]], "`Height` must be a number, but is 'loose'."),
    25: (lambda row: row[:1], "has 1 values for 4 names; decimal commas need semicolons between columns, remarks "
        "with commas quotes."),
}  # fmt: skip
"""Faults by the line: how a row is changed, and what an error says."""


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
def test_all_faults_are_told_at_once_in_the_file_s_units(tmp_path):
    spoiled = rows(lambda row, k: FAULTS.get(k + 1, [lambda row: row])[0](row))
    spoiled[0] = spoiled[0].replace("mm", "s")
    with pytest.raises(TableError) as told:
        read(tmp_path, spoiled)
    first, *lines = str(told.value).splitlines()
    assert first == f"{tmp_path / 'table.csv'} has 6 faults:"
    assert lines[0].startswith("  table.csv, line 1: `Height` must be in a unit like m, but is in 's'")
    assert lines[1:] == [f"  table.csv, line {k + 1}: {text}" for k, (_, text) in FAULTS.items()]


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
def test_one_fault_is_one_line_and_many_are_counted(tmp_path):
    for count in (1, 2, MOST_SHOWN, MOST_SHOWN + 3):
        spoiled = rows(lambda row, k, count=count: ["?", *row[1:]] if k < count else row)
        with pytest.raises(TableError) as told:
            read(tmp_path, spoiled)
        lines = str(told.value).splitlines()
        assert len(lines) == {1: 1, 2: 3, MOST_SHOWN: MOST_SHOWN + 1, MOST_SHOWN + 3: MOST_SHOWN + 2}[count]
        assert "line 2: `Chainage` must be a number, but is '?'." in str(told.value)
    assert lines[0].endswith(f"has {MOST_SHOWN + 3} faults:")
    assert lines[-1] == "  and 3 more."


@pytest.mark.filterwarnings("ignore::slipperjax.ImplausibleWarning")
def test_a_column_that_falls_is_one_fault(tmp_path):
    head, *below = rows()
    with pytest.raises(TableError, match=r"csv: `Chainage` falls from row to row: reverse the rows\.$"):
        read(tmp_path, [head, *below[::-1]])


def test_faults_of_netcdf_files_are_told_by_sample(tmp_path):
    values = np.arange(9.0)
    values[[2, 5]] = np.nan
    of = lambda values: ("row", values, {"units": "ft"})
    xr.Dataset({"distance": of(np.array([0.0, 1, 2, 2, 4, 5, 6, 7, 8])), "height": of(values)}).to_netcdf(
        tmp_path / "table.nc", engine="h5netcdf"
    )
    found = Table(tmp_path / "table.nc", (tmp_path / "table.nc").read_bytes(), WANTED, ALIASES)
    found.check_rising("distance")
    with pytest.raises(TableError) as told:
        found.si()
    assert [line.partition(", ")[2] for line in str(told.value).splitlines()[1:]] == [
        "sample 2: `height` has no number.",
        "sample 3: distance 2 ft does not exceed 2 ft of sample 2.",
        "sample 5: `height` has no number.",
    ]
