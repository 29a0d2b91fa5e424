"""The style of pictures and what a user changes of it, and pictures as files."""

import re
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
import pytest

from slipperjax import plots
from slipperjax.plots.environment import finish_spectrum
from slipperjax.plots.style import COLORS, color_bar, color_norm, content_of, entitle, fit_scale, png
from slipperjax.plots.sweeps import of_sweep

from .shown import drawn, legend, marked
from .test_plots import LINE, followed, measured, sections, trajectory

CYCLE = ["#0072b2", "#d55e00", "#009e73", "#cc79a7"]


def letters(figure):
    """Gives the letters of panels, and their places in the axes."""
    texts = [(text.get_text(), text.xy) for ax in figure.axes for text in ax.texts]
    return [text for text in texts if re.fullmatch(r"\([a-z]\)", text[0])]


def page():
    return plots.bifurcations(sections().assign_attrs({"length [m]": 0.2}))[0].figure


def test_panels_have_letters_in_their_corners_and_one_width():
    figure = page()
    assert letters(figure) == [(f"({name})", (0, 1)) for name in "abcde"]
    figure.draw_without_rendering()
    boxes = [ax.get_position() for ax in figure.axes]
    # each is as wide as the one above it, so that speeds can be compared
    for above, below in zip(boxes[:2], boxes[2:], strict=False):
        assert (above.x0, above.x1) == pytest.approx((below.x0, below.x1))
    assert letters(plots.exponents(measured(LINE)).figure) == []


def test_titles_letters_widths_and_settings_are_as_asked_also_within_one_another():
    with plots.styled({"font.size": 11}, width=5.0, titles=False):
        with plots.styled(letters=False):
            figure = page()
            assert (figure.get_suptitle(), letters(figure)) == ("", [])
            assert (figure.get_figwidth(), plt.rcParams["font.size"]) == (5.0, 11)
        assert len(letters(page())) == 5
        # what means nothing is told all the same
        assert plots.overview(trajectory(status=2))[0, 0].figure.get_suptitle().startswith("status: ")
    assert (page().get_suptitle(), page().get_figwidth()) == ("length 0.2 m", 7.2)


def test_titles_end_their_lines_at_commas_before_the_figure_ends():
    figure = plt.figure(figsize=(3.5, 2.0))
    entitle(figure, "speed 820.2 ft/s, clearance 0.03937 in, length 0.6562 ft, mass 30.86 lb, gravity 9.81 m/s^2")
    # with "mass 30.86 lb," the first line would be 0.99 of the width, and matplotlib breaks such lines anywhere
    lines = ["speed 820.2 ft/s, clearance 0.03937 in, length 0.6562 ft,", "mass 30.86 lb, gravity 9.81 m/s^2"]
    assert figure.get_suptitle().splitlines() == lines


def test_lines_take_the_colours_of_a_cycle_also_in_axes_of_another_style():
    _, ax = plt.subplots()
    with plots.styled({"axes.prop_cycle": plt.cycler(color=CYCLE)}):
        (line,) = plots.history(trajectory(), "y", ax).lines
        up, down = marked(plots.bifurcation(followed([(0,) * 4] * 2), "v_y"), ".")
    assert [one.get_color() for one in (line, up, down)] == [CYCLE[0], CYCLE[3], CYCLE[2]]
    assert plots.history(trajectory(), "y").lines[0].get_color() == COLORS["blue"]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (dict(settings={"font.colour": "red"}), "`settings` must have names of matplotlib's settings"),
        (dict(width=-1.0), "`width` must be positive"),
    ],
)
def test_wrong_styles_are_named(wrong, words):
    before = dict(plt.rcParams)
    with pytest.raises(ValueError, match=f"^Argument {words}"), plots.styled(**wrong):
        pass
    assert dict(plt.rcParams) == before


def label_boxes(axis):
    """Gives the extents of the labels within the limits of an axis, where alone matplotlib draws them."""
    low, high = axis.get_view_interval()
    ticks = zip(axis.get_major_ticks(), axis.get_majorticklocs(), strict=True)
    # a colour bar has its labels at the other side
    texts = [tick.label1 if tick.label1.get_visible() else tick.label2 for tick, at in ticks if low <= at <= high]
    return [text.get_window_extent() for text in texts]


@pytest.mark.parametrize("height", [0.6, 1.1, 3.0])
@pytest.mark.parametrize("top", [9.0, 150.0, 1e3, 1e5, 1e8, 1e12])
def test_logarithmic_axes_have_labels_which_do_not_touch(height, top):
    with plots.styled():
        figure, ax = plt.subplots(figsize=(3.5, height + 0.6))
        values = np.geomspace(1.0, top, 9)
        color_bar(ax, ax.scatter(values, values, c=values, norm=color_norm(values)), "force [N]")
        fit_scale(ax, values)
        figure.draw_without_rendering()
    for axis in (one.yaxis for one in figure.axes):
        boxes = label_boxes(axis)
        assert len(boxes) >= 2
        assert all(below.y1 < above.y0 for below, above in pairwise(boxes))


@pytest.mark.parametrize("width", [1.5, 2.0, 3.0, 7.0])
@pytest.mark.parametrize("highest", [2e3, 2e4, 1e6, 1e12])
def test_axes_over_frequency_have_labels_which_do_not_touch(width, highest):
    edges = np.array([5.0, highest])
    with plots.styled():
        figure, ax = plt.subplots(figsize=(width, 2.0))
        ax.plot(edges, edges)
        finish_spectrum(ax, edges)
        figure.draw_without_rendering()
    boxes = label_boxes(ax.xaxis)
    assert len(boxes) >= 2
    assert all(left.x1 < right.x0 for left, right in pairwise(boxes))


def test_files_keep_text_and_fonts_and_close_their_figures():
    pdf, svg = (content_of(plots.exponents(measured(LINE)).figure, form) for form in ("pdf", "svg"))
    assert png(page(), 100).startswith(b"\x89PNG")
    assert b"/TrueType" in pdf or b"/CIDFontType2" in pdf
    assert b"/Type3" not in pdf
    assert b">periodic</text>" in svg
    assert plt.get_fignums() == []
    with pytest.raises(ValueError, match="`figure` must be a figure of matplotlib"):
        png(3, 100)


def test_numbers_of_both_ways_are_curves_over_the_parameter():
    ds = followed([(0, 0, 0, 1), (0,) * 4]).drop_vars(["v_y", "v_z", "w_x", "w_y", "w_z"])
    ds["impulse"] = (("direction", "clearance"), [[1.0, 2.0, 3.0, 4.0], [1.0, 2.5, 3.5, 4.0]])
    ax = of_sweep(ds)
    up, down = (line for line in ax.lines if line.get_linestyle() == "-")
    assert legend(ax) == ["followed up", "not trusted", "followed down"]
    np.testing.assert_array_equal(drawn(up)[:, 1], [1.0, 2.0, 3.0, np.nan])
    np.testing.assert_allclose(drawn(down), np.stack([[0.5, 1, 1.5, 2], [1.0, 2.5, 3.5, 4.0]], axis=1))
