"""Results as notebooks show them."""

import re

import pytest

import slipperjax as sj
from slipperjax.tools.html import repr_html


class Result:
    def __init__(self, text):
        self.text = text

    _repr_html_ = repr_html

    def __repr__(self):
        return self.text


@pytest.mark.parametrize(
    ("text", "heading", "rows"),
    [
        (
            "Orbit(period 1,\n  multipliers <0.5>,\n  status 0)",
            "Orbit: period 1",
            [["multipliers &lt;0.5&gt;"], ["status 0"]],
        ),
        (
            "Branch of 9 points\n  label  speed\n  LP      2234.7\nall",
            "Branch of 9 points",
            [["label", "speed"], ["LP", "2234.7"], ["all"]],
        ),
        ("Curve", "Curve", []),
    ],
)
def test_a_table_has_the_lines_of_the_repr(text, heading, rows):
    shown = Result(text)._repr_html_()
    assert re.search("<b>(.*?)</b>", shown)[1] == heading
    assert [re.findall("<td.*?>(.*?)</td>", row) for row in re.findall("<tr>(.*?)</tr>", shown)] == rows


def test_scenes_and_stores_are_shown(tmp_path):
    assert '<td style="text-align:left">Slipper(mass=14 kg' in sj.paper_scene()._repr_html_()
    assert sj.Store(tmp_path / "a.zarr")._repr_html_().endswith("a.zarr</b><br>nothing yet")
