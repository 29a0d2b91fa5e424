"""Comparison of designs on common rails and starts: quantiles, their errors, and the errors of differences."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from ..analysis.quantiles import (
    Estimates,
    bootstrap,
    check_quantile,
    estimate,
    least_rails,
    sample_fit,
    standard_error,
    whole_rails,
)
from ..flow.numbers import ONE_PERIOD, AbstractNumber
from ..flow.status import MEANINGS, Status, is_lost, with_accuracy
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import START
from ..model.rails import SampledTrack, TrackSet
from ..model.random_rails import RandomRails, RandomTrack
from ..model.scene import Scene, check_scene
from ..model.tracks import AbstractSum, AbstractTrack, AbstractTwoRails
from ..orbits.simulate import first_of
from ..results.result import Result
from ..tools.checks import brief, finite, instance, number, one_of, require, warn, whole
from ..tools.columns import column
from ..tools.files import first_ones
from .grid import Grid, sample_box
from .runs import run
from .windows import run_record, whole_run

RESAMPLES = 400
SPREAD = {"start_v_y": 0.1, "start_v_z": 0.1, "start_w_x": 0.5, "start_w_y": 0.5, "start_w_z": 0.5}
"""Greatest difference of starts from the first start, in both directions [m/s], [rad/s]: small, but enough for chaos.
"""


def compare(
    scene: Scene,
    designs: Mapping[str, object],
    *,
    length: float,
    rails: int = 80,
    starts: int = 1,
    record: str = "peak_slipper_force",
    mean_over: str = "distance",
    quantiles: Sequence[float] = (0.5, 0.95),
    start: object = None,
    seed: int = 0,
    product: bool = True,
    **options: object,
) -> Result:
    """Compare designs by runs over the same rails from the same starts: which is better, and how certain this is.

    ```python
    ds = sj.compare(scene, {"clearance": [0.8e-3, 1.5e-3]}, length=300.0)
    ds["difference"].sel(quantile=0.95)  # with ds["difference_stderr"]
    ```

    **Arguments:**

    - `designs`: values by parameter, as the grid of `sweep`.
    - `length`: length of each run [m]; `options`: other arguments of `run`, such as `speed`, `begin`, `store`.
    - `rails`: number of rails, or of pairs of rails. Only rails are independent: the median needs 8, the quantile
        0.95 needs 80. Rails of a `RandomTrack` or of `RandomRails` have its seed and the following seeds. For a
        survey the first rail is the survey, and the others are similar, see `RandomTrack.like` and
        `RandomRails.like`. On a single rail starts count as rails, and the results hold only for this rail.
    - `starts`: number of starts on each rail; all but the first differ from `start`, by default at rest, by up to
        `SPREAD`.
    - `record`: name of a number of `run`. The number of a run is the highest value of all its windows; for impacts,
        heat and impulses it is the sum, for means and root mean squares the mean or root mean square. By default the
        greatest net force of a slipper.
    - `mean_over`: whether means and root mean squares are over "distance" or over "time".
    - `quantiles`: shares of runs with smaller numbers [1]; the last quantile orders the designs.
    - `seed`: of the starts and of the bootstrap.

    **Returns:** a `Result` over the designs with `runs`, the numbers of all runs over `rail` and `start`, NaN for a
    lost run, also with twice the steps; and `counted`, whether a rail has all its runs with all designs, because only
    such rails count for quantiles. Over `quantile` it also has `value`, `stderr`, `low`, `high`, `difference`,
    `difference_stderr`, `difference_low` and `difference_high` as `over_rails`, but with differences from the `best`
    design, the design with the lowest last quantile.

    **Raises:** `ValueError` that names the wrong argument.
    """
    scene = check_scene(scene)
    rails = whole("rails", rails, 1)
    starts = whole("starts", starts, 1)
    seed = whole("seed", seed, 0)
    of_windows = run_record(record)
    if of_windows is None:
        raise ValueError(
            f"Argument `record` must be the name of a number, such as peak_slipper_force, but is {brief(record)}."
        )
    require(of_windows.join is not ONE_PERIOD, "record", "be a number that several windows have in common", record)
    given = instance("quantiles", quantiles, Sequence, "a list of shares, such as [0.95]")
    shares = [number(finite, "quantiles", share) for share in given]
    one_of("mean_over", mean_over, ("distance", "time"))
    independent, counted = (starts, "starts") if rails == 1 and starts > 1 else (rails, "rails")
    for share in shares:
        check_quantile(share, independent, counted)
    scene, of_rails = on_rails(scene, rails)
    require(isinstance(designs, Mapping), "designs", "name parameters with their values", designs)
    designs_of = Grid(scene, designs, product=product)
    first = first_of("rest" if start is None else start)
    count = designs_of.count
    # each design runs on each rail from each start, as lists side by side
    each = designs_of.part(designs_of.spread(count))
    cases = {name: np.repeat(values, rails * starts) for name, values in each.items()}
    cases |= {name: np.tile(np.repeat(values, starts), count) for name, values in of_rails.items()}
    if starts > 1:
        for name, shift in _starts(first, starts, seed).items():
            require(name not in cases, "designs", "be no starts where these are drawn", name)
            cases[name] = np.tile(shift, count * rails)
    of_runs = dict(length=length, record=record, start=first, product=False)
    ds = run(scene, cases, **of_runs, **options).ds
    numbers = _numbers(of_windows, ds, mean_over)
    status = ds["status"].values.copy()
    # runs of other shares of a store are not there yet
    lost = np.flatnonzero(is_lost(status) & (status != Status.NOT_RUN))
    # one impact among thousands may need more steps
    if len(lost):
        again = {name: values[lost] for name, values in cases.items()}
        # with given steps, or with the steps that the scenes need
        factor = "refine" if options.get("steps_per_period") is None else "steps_per_period"
        more = {name: value for name, value in options.items() if name not in ("store", "executor")}
        more[factor] = 2 * whole(factor, more.get(factor, 1), 1)
        finer = run(scene, again, **of_runs, **more).ds
        numbers[lost] = _numbers(of_windows, finer, mean_over)
        status[lost] = finer["status"].values
    ensembles = (count, rails, starts)
    made = _compared(designs_of, numbers.reshape(ensembles), status.reshape(ensembles), ds, record, shares, seed)
    # the call also states how the runs were made
    asked = json.loads(ds.attrs["call"]) | dict(function="compare", rails=rails, starts=starts, quantiles=shares)
    over = mean_over if of_windows.join.weighted else ""
    return Result(made.assign_attrs(mean_over=over, call=json.dumps(asked)))


def _numbers(record: AbstractNumber, ds: xr.Dataset, mean_over: str = "distance") -> Float[np.ndarray, " cases"]:
    """Return the number of each run over its windows, the highest of all points or slippers; NaN for lost runs."""
    joined = whole_run(ds, record, mean_over).transpose("case", ...).values
    numbers = np.asarray(record.join.size(joined)).reshape(len(joined), -1).max(axis=1)
    return np.where(is_lost(ds["status"].values), np.nan, numbers)


def on_rails(scene: Scene, rails: int) -> tuple[Scene, dict[str, np.ndarray]]:
    """Return a scene on a track of many independent rails, and the parameters that choose a rail, as lists side by
    side for `run(..., product=False)`.

    For a survey the first rail is the survey, and the others are similar, see `RandomTrack.like` and
    `RandomRails.like`. Random rails have the seed of the track and the following seeds. In a `SumTrack`, or in a
    `FaultyTrack`, the first track changes, and the second is on every rail.

    **Raises:** `ValueError` for more than one rail on a track that is neither random nor a survey.
    """
    track, chosen = _many_rails(scene.track, whole("rails", rails, 1))
    return replace(scene, track=track), {f"track.{name}": values for name, values in chosen.items()}


def _many_rails(track: AbstractTrack, rails: int) -> tuple[AbstractTrack, dict[str, np.ndarray]]:
    """Return a track of many rails, and the values of its parameters for each rail, by their paths in the track."""
    count = np.arange(float(rails))
    if rails == 1:
        return track, {}
    if isinstance(track, AbstractSum):
        one, chosen = _many_rails(track.one, rails)
        return replace(track, one=one), {f"one.{name}": values for name, values in chosen.items()}
    if all(isinstance(rail, SampledTrack) for rail in track.rails.values() or (track,)):
        # the survey itself, and rails similar to it
        like = RandomRails.like(track) if isinstance(track, AbstractTwoRails) else RandomTrack.like(track)
        both = TrackSet((track, like))  # pyright: ignore[reportCallIssue] - `ends` is a property
        return both, {"number": np.minimum(count, 1.0), "tracks.1.seed": count}
    need = "be 1 on a track that is neither random nor a survey"
    require(track.chosen_by, "rails", need, rails)
    if isinstance(track, TrackSet):
        require(rails <= len(track.tracks), "rails", f"be {len(track.tracks)} at most, as the track has", rails)
    first = float(getattr(track, track.chosen_by)) if isinstance(track, RandomTrack | RandomRails) else 0.0
    return track, {track.chosen_by: first + count}


def _starts(first: Motion | State, starts: int, seed: int) -> dict[str, np.ndarray]:
    """Return velocities of starts around the first start, which is the first of them."""
    require(isinstance(first, Motion), "starts", "be 1 where a run goes on from a state", starts)
    drawn = sample_box({name: (-size, size) for name, size in SPREAD.items()}, starts, seed=seed)
    shifts = {name: np.append(0.0, values[1:]) for name, values in drawn.items()}
    return {name: float(getattr(first, name.removeprefix(START))) + shift for name, shift in shifts.items()}


def _compared(
    designs: Grid,
    numbers: Float[np.ndarray, "designs rails starts"],
    status: Int[np.ndarray, "designs rails starts"],
    ds: xr.Dataset,
    record: str,
    shares: Sequence[float],
    seed: int,
) -> xr.Dataset:
    """Return the dataset of `compare` from the numbers and statuses of all runs; `ds`: the dataset of the runs."""
    count, rails, starts = numbers.shape
    # runs on one rail are drawn together; on a single rail each start is drawn
    grouped = np.moveaxis(numbers, 0, -1)
    groups = grouped if rails > 1 else np.moveaxis(grouped, 1, 0)
    draws = dict(resamples=RESAMPLES, seed=seed)
    unit = ds[record].attrs["units"]
    # the last quantile decides
    last = estimate(groups, shares[-1], None, **draws)
    best = int(np.argmin(last.value))
    found = [*(estimate(groups, share, best, **draws) for share in shares[:-1]), last]
    dims = designs.dims
    over = (*dims, "quantile")
    shape = (*designs.shape, len(shares))
    all_shares = Estimates(*(np.stack(of_each, axis=-1) for of_each in zip(*found, strict=True)))
    data = estimated_columns(over, shape, all_shares, unit, "quantile of the runs", "the best design")
    data["runs"] = (*dims, "rail", "start"), numbers.reshape(*designs.shape, rails, starts), ds[record].attrs
    codes = status.reshape(data["runs"][1].shape)
    data["status"] = column(data["runs"][0], codes, "", "status of each run", meaning=MEANINGS)
    counted = np.broadcast_to(whole_rails(groups)[:, None], groups.shape[:2]).reshape(rails, starts)
    data["counted"] = column(("rail", "start"), counted, "", "whether no run on the rail is lost")
    is_best = (np.arange(count) == best).reshape(designs.shape)
    data["best"] = column(dims, is_best, "", "whether the design has the lowest value of the last quantile")
    coords = designs.coordinates() | {"quantile": column("quantile", list(shares), "1", "share of the runs below")}
    # rails vary in runs, but are no coordinates of a comparison
    return xr.Dataset(data, coords, ds.attrs | {"record": record, "varied": json.dumps(list(designs.axes))})


def over_rails(
    values: xr.DataArray,
    quantile: float | None = 0.95,
    *,
    dim: str = "track.seed",
    finer: xr.DataArray | None = None,
    resamples: int = 400,
    seed: int = 0,
) -> xr.Dataset:
    """Compute a quantile over rails, with its error, and the differences between cases on the same rails.

    ```python
    rails = dict(transient=5, periods=60, record="peak_force")  # for which 1000 m of rail are long enough
    ds = sj.sweep(scene, {"clearance": [0.5e-3, 1e-3], "track.seed": range(400)}, **rails)
    over_rails(ds["peak_force"].max(("end", "point")))  # for a sled also "slipper"
    ```

    With `finer`, results with more steps on some of the rails, it also shows the effect of the number of steps.
    Chaotic runs differ with the steps, but the distribution over rails must stay the same.

    ```python
    fine = sj.sweep(scene, {"clearance": [0.5e-3, 1e-3], "track.seed": range(100)}, refine=2, **rails)
    ```

    **Arguments:** `values`: one number for each case and rail; `quantile`: the share of rails with smaller values
    [1], or None for the mean; `dim`: the dimension of the rails; `finer`: as `values`, on some of the rails;
    `resamples`, `seed`: number and random seed of the bootstrap's samples.

    **Returns:** an `xarray.Dataset` over the other dimensions, in the unit of `values` unless another is named, with

    - `value`, the quantile or the mean;
    - `stderr`, by the bootstrap; `low` and `high`, its 95 % confidence interval: for quantiles from order statistics;
    - `difference` from the first case along the other dimensions, and `difference_stderr` by the bootstrap;
      `difference_low` and `difference_high`, the 95 % interval that holds for all differences at once;
    - with `finer`: `step_change` [1], the relative change from the same rails in `values`, its standard error
      `step_change_stderr`, and `status`, `Status.INACCURATE` where the change is above a tenth by more than twice its
      error.

    Rails with a NaN value, because a slipper was lost, are left out in all cases, with a warning. Where too few rails
    remain, results are NaN.

    **Raises:** `ValueError` that names the wrong argument.
    """
    instance("values", values, xr.DataArray, "an xarray.DataArray of a sweep")
    one_of("dim", dim, [str(name) for name in values.dims])
    others = [name for name in values.dims if name != dim]
    rows = values.transpose(dim, *others)
    numbers = rows.values.reshape(len(rows), -1)
    check_quantile(quantile, len(numbers), f"values.sizes[{dim!r}]")
    lost = rows[dim].values[~whole_rails(numbers)]
    if len(lost):
        named = first_ones([f"{number:g}" for number in lost])
        warn(f"{len(lost)} of {len(numbers)} rails are left out, because a run is lost there: {dim} {named}.")
    draws = dict(resamples=whole("resamples", resamples, 2), seed=whole("seed", seed, 0))
    found = estimate(numbers[:, None], quantile, 0, **draws)
    text = "mean" if quantile is None else f"quantile {quantile:g}"
    shape = tuple(rows.sizes[name] for name in others)
    data = estimated_columns(others, shape, found, values.attrs.get("units", ""), text)
    if finer is not None:
        # drawn together, so that both have the same rails in each resample
        pairs = np.concatenate([part.values.reshape(len(part), -1) for part in _same_rails(finer, rows, dim)], axis=1)
        check_quantile(quantile, len(pairs), f"finer.sizes[{dim!r}]")
        parts = _step_change(pairs[whole_rails(pairs)], quantile, **draws)
        change, error = (part.reshape(shape) for part in parts)
        data["step_change"] = column(others, change, "1", "relative change by more steps")
        data["step_change_stderr"] = column(others, error, "1", "standard error of the relative change")
        status = with_accuracy(np.zeros(shape, int), np.abs(change), error)
        data["status"] = column(others, status, "", "status", meaning=MEANINGS)
    coords = {name: values.coords[name] for name in others if name in values.coords}
    facts = dict(rails=len(numbers) - len(lost), quantile="none" if quantile is None else quantile)
    return xr.Dataset(data, coords, facts)


def estimated_columns(
    dims: Sequence[str],
    shape: tuple[int, ...],
    found: Estimates,
    unit: str,
    text: str,
    base: str = "the first case",
) -> dict[str, object]:
    """Return the variables of `over_rails` over some dimensions, by their names.

    **Arguments:** `text`: description of the values; `base`: the case from which differences count.
    """
    words = dict(
        value=text,
        stderr="standard error",
        low="lower end of the 95 % interval",
        high="upper end of the 95 % interval",
        difference=f"difference from {base}",
        difference_stderr="standard error of the difference",
        difference_low="lower end of the 95 % interval of all differences at once",
        difference_high="upper end of the 95 % interval of all differences at once",
    )
    return {name: column(dims, getattr(found, name).reshape(shape), unit, word) for name, word in words.items()}


def _step_change(
    pairs: Float[np.ndarray, "rails twice_cases"], quantile: float | None, **draws: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the relative change of each case by more steps, whose values come first, and its standard error [1]."""
    if len(pairs) < least_rails(quantile):
        unknown = np.full(pairs.shape[1] // 2, np.nan)
        return unknown, unknown
    both = sample_fit(pairs[:, None], quantile)
    change, drawn = bootstrap(lambda weights: np.divide(*np.split(both(weights), 2)) - 1, len(pairs), **draws)
    return change, standard_error(drawn, len(pairs))


def _same_rails(finer: xr.DataArray, rows: xr.DataArray, dim: str) -> tuple[xr.DataArray, xr.DataArray]:
    """Return values with more steps, and values of the same rails in `rows`.

    **Raises:** `ValueError` where `finer` has other dimensions, or rails that are not in `rows`.
    """
    instance("finer", finer, xr.DataArray, "an xarray.DataArray of a sweep")
    need = f"have the dimensions {', '.join(map(str, rows.dims))}"
    require(set(finer.dims) == set(rows.dims), "finer", need, shown=", ".join(map(str, finer.dims)))
    fine = finer.transpose(*rows.dims)
    good = fine.shape[1:] == rows.shape[1:] and fine[dim].isin(rows[dim]).all()
    require(
        good,
        "finer",
        "be of the same cases, on rails that are among those of `values`",
        shown="of others",
    )
    return fine, rows.sel({dim: fine[dim]})
