"""Designs compared on common rails and starts: quantiles, their errors, and the errors of differences."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.stats
import xarray as xr
from jaxtyping import Float, Int

from ..analysis.quantiles import bootstrap, check_quantile
from ..flow.records import ONE_PERIOD, AbstractNumber
from ..flow.simulate import first_of
from ..flow.status import MEANINGS, is_lost, with_accuracy
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.parameters import START
from ..model.rails import SampledTrack, TrackSet
from ..model.random_rails import RandomRails, RandomTrack
from ..model.scene import Scene, check_scene
from ..model.tracks import AbstractTwoRails
from ..tools.checks import brief, instance, one_of, require, whole
from ..tools.columns import column
from .grid import Grid, sample_box
from .runs import run
from .windows import run_record

Draws = Mapping[str, int]
"""Options of `slipperjax.analysis.quantiles.bootstrap`."""
RESAMPLES = 400
SPREAD = {"start_v_y": 0.1, "start_v_z": 0.1, "start_w_x": 0.5, "start_w_y": 0.5, "start_w_z": 0.5}
"""Greatest difference of starts from the first one, either way [m/s], [rad/s]: little, and more than chaos needs."""


def compare(
    scene: Scene,
    designs: Mapping[str, object],
    *,
    length: float,
    rails: int = 1,
    starts: int = 1,
    record: str = "peak_slipper_force",
    quantiles: Sequence[float] = (0.5, 0.95),
    start: object = None,
    seed: int = 0,
    product: bool = True,
    **options: object,
) -> xr.Dataset:
    """Compare designs by runs over the same rails from the same starts, and say which one is better, and how sure.

    ```python
    ds = sj.compare(scene, {"clearance": [0.8e-3, 1.5e-3]}, length=300.0, rails=32, starts=4)
    ds["difference"].sel(quantile=0.95)  # with ds["difference_stderr"]
    ```

    **Arguments:**

    - `designs`: values by parameter, as the grid of `sweep`.
    - `length`: how far each run goes [m]; `options`: others of `run`, such as `speed`, `begin`, `store`.
    - `rails`: number of rails, or of pairs of rails. Those of a `RandomTrack` or of `RandomRails` have its seed and
        the next ones; of a survey the first is the survey itself, and the others are like it, see `RandomTrack.like`
        and `RandomRails.like`.
    - `starts`: number of starts on each rail; all but the first differ from `start`, by default at rest, by up to
        `SPREAD`.
    - `record`: name of a number of `run`, of which a run counts the highest, of impacts, heat and impulses the sum,
        of means and root mean squares that of all its windows; by default the greatest net force of a slipper.
    - `quantiles`: shares of runs whose numbers lie below [1]; designs are ordered by the last.
    - `seed`: of the starts and of the bootstrap.

    **Returns:** an `xarray.Dataset` over the designs with `runs`, the numbers of all runs over `rail` and `start`,
    NaN where one was lost, also with twice the steps; and over `quantile`, too, `value`, `stderr`, `low`, `high`,
    `difference` and `difference_stderr` as of `over_rails`, but from the `best` design, of the lowest last quantile.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    scene = check_scene(scene)
    rails = whole("rails", rails, 1)
    starts = whole("starts", starts, 1)
    require(rails * starts > 1, "rails", "be 2 or more, or `starts`", rails)
    of_windows = run_record(record)
    if of_windows is None:
        raise ValueError(
            f"Argument `record` must be the name of a number, such as peak_slipper_force, but is {brief(record)}."
        )
    require(of_windows.join is not ONE_PERIOD, "record", "be a number that several windows have in common", record)
    shares = [
        float(share) for share in instance("quantiles", quantiles, Sequence, "a list of shares, such as [0.95]")
    ]
    # one warning, of the quantile with the fewest runs beyond it
    for share in sorted(shares, key=lambda share: min(share, 1 - share))[:1]:
        check_quantile(share, rails * starts)
    scene, of_rails = _on_rails(scene, rails)
    designs_of = Grid(scene, designs, product=product)
    first = first_of("rest" if start is None else start)
    count = designs_of.count
    # each design runs on each rail from each start, side by side
    each = np.unravel_index(np.arange(count), designs_of.shape)
    cases = {name: np.repeat(v, rails * starts) for name, v in designs_of.part(each).items()}
    cases |= {name: np.tile(np.repeat(values, starts), count) for name, values in of_rails.items()}
    if starts > 1:
        for name, shift in _starts(first, starts, seed).items():
            require(name not in cases, "designs", "be no starts where these are drawn", name)
            cases[name] = np.tile(shift, count * rails)
    of_runs = dict(length=length, record=record, start=first, product=False)
    ds = run(scene, cases, **of_runs, **options)
    numbers = _numbers(of_windows, ds)
    status = ds["status"].values.copy()
    lost = np.flatnonzero(is_lost(status))
    # one impact among thousands may need more steps
    if len(lost):
        again = {name: values[lost] for name, values in cases.items()}
        # of steps that are given, or of those that the scenes need
        number = "refine" if options.get("steps_per_period") is None else "steps_per_period"
        more = {name: value for name, value in options.items() if name not in ("store", "executor")}
        more[number] = 2 * whole(number, more.get(number, 1), 1)
        finer = run(scene, again, **of_runs, **more)
        numbers[lost] = _numbers(of_windows, finer)
        status[lost] = finer["status"].values
    ensembles = (count, rails, starts)
    return _compared(designs_of, numbers.reshape(ensembles), status.reshape(ensembles), ds, record, shares, seed)


def _numbers(record: AbstractNumber, ds: xr.Dataset) -> Float[np.ndarray, " cases"]:
    """Return the number of each run: of all its windows, the highest of all points or slippers; NaN for lost runs."""
    values = ds[record.name].transpose("distance", "case", ...).values
    joined = record.join.whole(values)
    numbers = np.asarray(record.join.size(joined)).reshape(len(joined), -1).max(axis=1)
    return np.where(is_lost(ds["status"].values), np.nan, numbers)


def _on_rails(scene: Scene, rails: int) -> tuple[Scene, dict[str, np.ndarray]]:
    """Return a scene on a track of many rails, and the parameters that choose one, with their values for each."""
    track = scene.track
    count = np.arange(float(rails))
    if rails == 1:
        return scene, {}
    if all(isinstance(rail, SampledTrack) for rail in track.rails.values() or (track,)):
        # the survey itself, and rails like it
        like = RandomRails.like(track) if isinstance(track, AbstractTwoRails) else RandomTrack.like(track)
        both = TrackSet((track, like))  # pyright: ignore[reportCallIssue] - `ends` is a property
        return replace(scene, track=both), {"track.number": np.minimum(count, 1.0), "track.tracks.1.seed": count}
    need = "be 1 on a track that is neither random nor a survey"
    require(track.chosen_by, "rails", need, rails)
    if isinstance(track, TrackSet):
        require(rails <= len(track.tracks), "rails", f"be {len(track.tracks)} at most, as the track has", rails)
    first = float(getattr(track, track.chosen_by)) if isinstance(track, RandomTrack | RandomRails) else 0.0
    return scene, {f"track.{track.chosen_by}": first + count}


def _starts(first: Motion | State, starts: int, seed: int) -> dict[str, np.ndarray]:
    """Return velocities of starts around the first one, which comes first."""
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
    """Return the dataset of `compare` from the numbers and statuses of all runs; `ds`: that of the runs."""
    count, rails, starts = numbers.shape
    # runs on one rail are drawn together; lost ones count as the highest
    grouped = np.moveaxis(np.where(np.isnan(numbers), np.inf, numbers), 0, -1)
    groups = grouped if rails > 1 else np.moveaxis(grouped, 1, 0)
    draws = dict(resamples=RESAMPLES, seed=seed)
    unit = ds[record].attrs["units"]
    last = _fit(groups, shares[-1])(np.ones(len(groups)))
    best = int(np.argmin(np.where(np.isfinite(last), last, np.inf)))
    each = [_columns(groups, share, best, unit, draws) for share in shares]
    dims = designs.dims
    data = {}
    for name, (_, unit, words) in each[0].items():
        stacked = np.stack([columns[name][0] for columns in each], axis=-1).reshape(*designs.shape, len(shares))
        text = words.replace("the first case", "the best design") if name != "value" else "quantile of the runs"
        data[name] = column((*dims, "quantile"), stacked, unit, text)
    data["runs"] = (*dims, "rail", "start"), numbers.reshape(*designs.shape, rails, starts), ds[record].attrs
    codes = status.reshape(data["runs"][1].shape)
    data["status"] = column(data["runs"][0], codes, "", "status of each run", meaning=MEANINGS)
    is_best = (np.arange(count) == best).reshape(designs.shape)
    data["best"] = column(dims, is_best, "", "whether the design has the lowest value of the last quantile")
    coords = designs.coordinates() | {"quantile": column("quantile", list(shares), "1", "share of the runs below")}
    return xr.Dataset(data, coords, ds.attrs | {"record": record})


def over_rails(
    values: xr.DataArray,
    quantile: float | None = 0.99,
    *,
    dim: str = "track.seed",
    finer: xr.DataArray | None = None,
    resamples: int = 400,
    seed: int = 0,
) -> xr.Dataset:
    """Compute a quantile over rails, with its error, and the differences between cases on the same rails.

    ```python
    rails = dict(transient=5, periods=60, record="peak_force")  # on which 1000 m of rail suffice
    ds = sj.sweep(scene, {"clearance": [0.5e-3, 1e-3], "track.seed": range(400)}, **rails)
    over_rails(ds["peak_force"].max(("end", "point")), 0.99)  # of a sled "slipper", too
    ```

    With `finer`, results of some of the rails with more steps, it also says what the number of steps changes: chaotic
    runs differ with the steps, but the distribution over rails must stay the same.

    ```python
    fine = sj.sweep(scene, {"clearance": [0.5e-3, 1e-3], "track.seed": range(100)}, refine=2, **rails)
    ```

    **Arguments:** `values`: one number for each case and rail; `quantile`: the share of rails whose values lie below
    it [1], or None for the mean; `dim`: the dimension of the rails; `finer`: as `values`, on some of their rails;
    `resamples`, `seed`: number and random seed of the bootstrap's samples.

    **Returns:** an `xarray.Dataset` over the other dimensions, in the unit of `values` where no other is named, with

    - `value`, the quantile or the mean;
    - `low` and `high`, its 95 % confidence interval: for quantiles from order statistics, otherwise two standard
      errors on both sides;
    - `stderr`, a quarter of the interval;
    - `difference` from the first case along the other dimensions, and `difference_stderr` by the bootstrap;
    - with `finer`: `step_change` [1], the relative change from the same rails in `values`, its standard error
      `step_change_stderr`, and `status`, `Status.INACCURATE` where the change is above a tenth by more than twice its
      error.

    Values that are NaN, where a slipper was lost, count as greater than all others when quantiles are taken. A result
    that depends on them is NaN.

    **Raises:** `ValueError` that names the argument which is wrong.
    """
    instance("values", values, xr.DataArray, "an xarray.DataArray of a sweep")
    one_of("dim", dim, [str(name) for name in values.dims])
    others = [name for name in values.dims if name != dim]
    rows = values.transpose(dim, *others)
    numbers = _of_rails(rows, quantile)
    require(len(numbers) > 1, "values", "have two or more rails", shown=f"{len(numbers)}")
    check_quantile(quantile, len(numbers))
    draws = dict(resamples=whole("resamples", resamples, 2), seed=whole("seed", seed, 0))
    columns = _columns(numbers[:, None], quantile, 0, values.attrs.get("units", ""), draws)
    if finer is not None:
        # drawn together, so that both have the same rails in each resample
        fine, same = (_of_rails(part, quantile) for part in _same_rails(finer, rows, dim))
        check_quantile(quantile, len(fine))
        pairs = _fit(np.concatenate([fine, same], axis=1), quantile)
        change, drawn = bootstrap(
            lambda weights: np.divide(*np.split(pairs(weights), 2)) - 1,
            len(fine),
            **draws,
        )
        error = drawn.std(axis=0, ddof=1)
        columns["step_change"] = change, "1", "relative change by more steps"
        columns["step_change_stderr"] = error, "1", "standard error of the relative change"
    shape = [rows.sizes[name] for name in others]
    data = {name: column(others, array.reshape(shape), *words) for name, (array, *words) in columns.items()}
    if finer is not None:
        status = with_accuracy(
            np.zeros(shape, int),
            np.abs(data["step_change"][1]),
            data["step_change_stderr"][1],
        )
        data["status"] = column(others, status, "", "status", meaning=MEANINGS)
    coords = {name: values.coords[name] for name in others if name in values.coords}
    facts = dict(rails=len(numbers), quantile="none" if quantile is None else quantile)
    return xr.Dataset(data, coords, facts)


def _columns(
    numbers: Float[np.ndarray, "groups members cases"], quantile: float | None, base: int, unit: str, draws: Draws
) -> dict[str, tuple[np.ndarray, str, str]]:
    """Return the variables of `over_rails`, each with its unit and description.

    **Arguments:** `numbers`: of groups that are drawn together, such as the runs over one rail; `base`: the case from
    which differences count; `draws`: options of `bootstrap`.
    """
    groups, members, _ = numbers.shape
    value, drawn = bootstrap(_fit(numbers, quantile), groups, **draws)
    if quantile is None or members > 1:
        stderr = drawn.std(axis=0, ddof=1)
        low = value - 2 * stderr
        high = value + 2 * stderr
    else:
        # true whatever the distribution, for as many values lie below as a binomial law says
        below = np.asarray(scipy.stats.binom.ppf([0.025, 0.975], groups, quantile), int)
        places = below - np.array([1, 0])  # from 0 on
        ends = np.sort(numbers[:, 0], axis=0)[np.clip(places, 0, groups - 1)]
        low, high = np.where(np.isfinite(ends), ends, np.nan)
        stderr = (high - low) / 4
    # all cases of a resample have the same rails, so that what these have in common cancels
    difference_stderr = (drawn - drawn[:, base : base + 1]).std(axis=0, ddof=1)
    return {
        "value": (value, unit, "mean" if quantile is None else f"quantile {quantile:g}"),
        "stderr": (stderr, unit, "standard error"),
        "low": (low, unit, "lower end of the 95 % interval"),
        "high": (high, unit, "upper end of the 95 % interval"),
        "difference": (value - value[base], unit, "difference from the first case"),
        "difference_stderr": (difference_stderr, unit, "standard error of the difference"),
    }


def _of_rails(rows: xr.DataArray, quantile: float | None) -> np.ndarray:
    """Return values of shape (rails, cases); for quantiles NaN becomes infinity, because lost slippers count most."""
    numbers = rows.values.reshape(len(rows), -1)
    return np.where(np.isnan(numbers) & (quantile is not None), np.inf, numbers)


def _fit(numbers: np.ndarray, quantile: float | None) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function of how often each group was drawn, which gives the quantiles or means of the cases.

    **Arguments:** `numbers`: (groups, members, cases), or (groups, cases).
    """

    def fit(weights: np.ndarray) -> np.ndarray:
        drawn = numbers[np.repeat(np.arange(len(numbers)), weights.astype(int))].reshape(-1, numbers.shape[-1])
        if quantile is None:
            return drawn.mean(axis=0)
        with np.errstate(invalid="ignore"):  # differences of infinite ones
            found = np.quantile(drawn, quantile, axis=0, method="median_unbiased")
        return np.where(np.isfinite(found), found, np.nan)

    return fit


def _same_rails(finer: xr.DataArray, rows: xr.DataArray, dim: str) -> tuple[xr.DataArray, xr.DataArray]:
    """Return values with more steps, and those of the same rails in `rows`.

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
