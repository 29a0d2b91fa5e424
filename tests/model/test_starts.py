"""Starts at rest: the static equilibrium, beside closed forms, an independent minimum, and runs that begin there."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import slipperjax as sj
from slipperjax.flow.datasets import load_base
from slipperjax.flow.period_map import initial_states
from slipperjax.model.quantities import MOTION_NUMBERS
from slipperjax.model.starts import at_rest, state_and_penetration
from slipperjax.tools.batching import Batched

from ..common import narrow_sled, sled_on

SCENE = dataclasses.replace(sj.paper_scene(stiffness=1e9, restitution=0.6), gravity=9.81)
LEVEL = dataclasses.replace(SCENE, track=sj.model.StraightTrack())
WEIGHT = 14.0 * 9.81
"""Of the paper's slipper [N]."""
LOADED = dataclasses.replace(SCENE, load=sj.model.AppliedLoad(force=[0.0, 300.0, -800.0], moment=[5.0, 30.0, -20.0]))
SPRUNG = dict(mass=100.0, stiffness=[2e6, 8e6], damping=[2e3, 8e3], travel=[1e-4, 1e-4], stop_stiffness=[1e7, 1e7])
SLED = dataclasses.replace(SCENE, payload=sj.model.Payload(**SPRUNG))


def state_of(scene, epoch=0.0, **added):
    return sj.initial_state(scene, sj.AtRest(**added), epoch)


def reactions_of(scene, epoch=0.0):
    return sj.model.reactions(0.0, state_of(scene, epoch), sj.model.Args(scene, epoch))


def test_a_slipper_on_a_level_rail_sinks_in_as_hertz_says():
    motion = state_of(LEVEL).motion
    # on the four points of its upper face
    depth = (WEIGHT / 4 / 1e9) ** (2 / 3)
    np.testing.assert_allclose(motion.z, -0.5e-3 - depth, rtol=1e-7)  # measured 1.3e-8, by what centres it
    others = [getattr(motion, name) for name in MOTION_NUMBERS if name != "z"]
    np.testing.assert_allclose(others, 0.0, atol=1e-12)
    np.testing.assert_allclose(reactions_of(LEVEL).contact_force.sum(), WEIGHT, rtol=1e-5)


@pytest.mark.full
@pytest.mark.parametrize("scene", [SCENE, LOADED, SLED, dataclasses.replace(LOADED, friction=sj.model.Coulomb(0.2))])
def test_all_forces_are_in_balance(scene):
    for epoch in (0.0, 3.3):
        state = state_of(scene, epoch)
        # gyroscopic moments come with the velocities
        still = {name: 0.0 for name in vars(state.motion) if "v_" in name or "w_" in name}
        if state.motion.payload is not None:
            still["payload"] = dataclasses.replace(state.motion.payload, v_y=0.0, v_z=0.0)
        state = sj.State(dataclasses.replace(state.motion, **still), state.memory)
        found = sj.model.reactions(0.0, state, sj.model.Args(scene, epoch)).acceleration
        np.testing.assert_allclose(found, 0.0, atol=1e-3)  # measured 1.1e-4 m/s^2, by what centres it


@pytest.mark.full
def test_the_contacts_carry_the_weight_as_the_slipper_travels():
    """Rounding errors of gap rates are no approach, by which contacts would be damped."""
    for epoch in (0.0, 3.3, 7.7):
        # measured 3.4e-3, as normals are tilted
        np.testing.assert_allclose(reactions_of(SCENE, epoch).contact_force.sum(), WEIGHT, rtol=1e-2)


@pytest.mark.full
def test_the_equilibrium_has_the_least_energy():
    """Beside a search of SciPy's that knows gaps alone."""
    epoch, stiff = 2.2, 1e7
    scene = LOADED.replace(stiffness=stiff)
    frame = sj.model.kinematics.rail_frame(scene, epoch)
    size = np.array([1e-3, 1e-3, 5e-3, 5e-3, 5e-3])
    push = np.array([300.0, -800.0 - WEIGHT, 2 * 5.0, 2 * 30.0, 2 * -20.0])

    @jax.jit
    def energy(unknown):
        gap = sj.model.kinematics.contacts(frame, sj.Motion(*(size * unknown))).gap
        return 0.4 * stiff * jnp.sum(jnp.maximum(-gap, 0.0) ** 2.5) - push @ (size * unknown)

    options = dict(jac=jax.grad(energy), method="BFGS", options=dict(gtol=1e-7, maxiter=3000))
    best = scipy.optimize.minimize(energy, jnp.zeros(5), **options)
    motion = state_of(scene, epoch).motion
    found = np.array([motion.y, motion.z, motion.q_x, motion.q_y, motion.q_z])
    np.testing.assert_allclose(found / size, best.x, atol=2e-3)
    assert float(energy(found / size)) <= best.fun + 1e-4


@pytest.mark.full
def test_what_nothing_holds_stands_in_the_middle_of_its_play():
    free = dataclasses.replace(LEVEL, gravity=None)
    np.testing.assert_allclose(jax.tree.leaves(state_of(free).motion), 0.0, atol=1e-12)
    # what is given is added
    assert float(state_of(free, v_z=0.2).motion.v_z) == pytest.approx(0.2)


@pytest.mark.full
def test_a_slipper_at_rest_follows_the_rail():
    """Its velocities are the change of the equilibrium along the rail."""
    before, here, after = (state_of(LOADED, 2.2 + shift).motion for shift in (-1e-5, 0.0, 1e-5))
    seconds = 2e-5 * 8.0 / 1250.0
    slope = jax.tree.map(lambda a, b: (a - b) / seconds, after, before)
    np.testing.assert_allclose([here.v_y, here.v_z], [slope.y, slope.z], rtol=1e-4, atol=1e-5)
    rates = sj.model.kinematics.attitude_rates(here)
    np.testing.assert_allclose(rates, [slope.q_x, slope.q_y, slope.q_z], rtol=1e-3, atol=1e-4)


@pytest.mark.full
def test_derivatives_are_those_of_the_equilibrium():
    depth = lambda mass: state_of(LEVEL.replace(mass=mass)).motion.z
    exact = -(2 / 3) * (14.0 * 9.81 / 4 / 1e9) ** (2 / 3) / 14.0
    for derivative in (jax.jacfwd, jax.grad):
        np.testing.assert_allclose(derivative(depth)(14.0), exact, rtol=1e-6)  # measured 2e-9
    clearances = jnp.array([0.5e-3, 1e-3])
    batch = jax.vmap(lambda c: state_of(LEVEL.replace(clearance=c)).motion.z)(clearances)
    np.testing.assert_allclose(batch[0] - batch[1], 0.25e-3, rtol=1e-7)  # measured 8e-10


@pytest.mark.full
@pytest.mark.parametrize("memory", [sj.model.EventLatch(), sj.model.SmoothSwitch()])
def test_runs_begin_without_a_hit(memory):
    scene = dataclasses.replace(LEVEL, memory=memory)
    run = sj.simulate(scene, 1, start="rest", steps_per_period=400)
    # the load is what lies on it; measured 1 + 2e-6 of the weight
    force = np.asarray(run.reactions.contact_force.sum((1, 2)))
    np.testing.assert_allclose(force, WEIGHT, rtol=1e-3)


@pytest.mark.full
def test_slippers_find_their_rest_on_many_rails():
    """Of stiffnesses from 1e6 to 1e12, plays from 0.01 to 5 mm, and lengths from 0.06 to 1 m."""
    rng = np.random.default_rng(0)
    count = 400
    values = (10 ** rng.uniform(6, 12, count), 10 ** rng.uniform(-5, -2.3, count), rng.uniform(0.06, 1.0, count))

    def start(stiffness, clearance, length, epoch):
        scene = LOADED.replace(stiffness=stiffness, clearance=clearance, length=length)
        return state_and_penetration(scene, sj.AtRest(), epoch)[0].motion.z

    found = jax.jit(jax.vmap(start))(*values, rng.uniform(1, 40, count))
    # measured all, also of 4000 others
    assert int(np.isfinite(found).sum()) == count


@pytest.mark.full
def test_sleds_find_their_rest_on_two_rails():
    """Stiff ones, which a few of their slippers could carry."""
    track = sj.model.RandomRails(sj.RandomTrack.sled(length=620.0, ramp=20.0), coherence=0.95)
    scene = dataclasses.replace(LEVEL, slipper=narrow_sled(), track=track).replace(clearance=0.8e-3, stiffness=1e10)

    def start(seed, epoch):
        at = dataclasses.replace(scene, track=dataclasses.replace(track, seed=seed).prepared())
        motion = state_and_penetration(at, sj.AtRest(), epoch)[0].motion
        return jnp.stack([motion.w_x, motion.w_y, motion.w_z])

    epochs = np.linspace(30.0, 580.0, 40) / float(scene.wavelength)
    found = jax.jit(jax.vmap(jax.vmap(start, (None, 0)), (0, None)))(np.arange(10.0), epochs)
    # measured all; of 800 such 800, and 680 with contacts that are stiff from the first
    assert int(np.isfinite(found).all(axis=-1).sum()) >= len(epochs) * 10 - 1
    # they turn with the rails, measured 1.5 rad/s; where hardly anything holds the yaw, its equilibrium turns by 340
    np.testing.assert_array_less(np.abs(np.nan_to_num(found)), 2.0)


def test_sleds_find_their_rest_on_twisted_rails():
    """Places at which three slippers carry by turns, of 2400 with stiffnesses and plays of four and one and a half
    decades."""
    # at the first four iterations with a bounded step end nowhere, at the others those that are never taken back
    places = [4.515242706516709, 8.605728134020634, 9.21248298770714, 6.770334873737982]
    places += [7.558057359754617, 11.816481526743589, 13.868068697373547, 15.009900846011641]
    stiffness = [1660976.471871991, 30666666.633018095, 22451337.63314037, 5838149.456013123]
    stiffness += [13115545.068676699, 170505129.98014283, 9520422.407709826, 5736740.730739701]
    play = [0.0019260690628046966, 0.00025270422970505656, 0.00021083454427515375, 0.0023114385983423204]
    play += [0.00021975341063131502, 0.0019688869367932293, 0.00047768226917894974, 0.00012087066172731417]
    track = sj.model.RandomRails(sj.RandomTrack.sled(length=200.0), coherence=0.3, seed=3)
    track = eqx.filter_jit(sj.model.RandomRails.prepared)(track)
    scene = dataclasses.replace(sj.paper_scene(600.0), slipper=narrow_sled(), track=track, gravity=9.81)

    def heights(place, stiffness, clearance):
        return at_rest(scene.replace(stiffness=stiffness, clearance=clearance), place).z

    found = jax.jit(jax.vmap(heights))(*map(jnp.array, (places, stiffness, play)))
    assert np.isfinite(found).all()


@pytest.mark.full
def test_what_finds_no_rest_is_said():
    """A slipper of one face, which a load pulls off the rail; and a sled that a moment turns over, the slippers of
    which do not reach around the rail, beside one that rests."""
    one = sj.Section(points=[[0.03, 0.013], [-0.03, 0.013]], play=[5e-4], names=("J", "A"), faces=(("A", "J"),))
    off = dataclasses.replace(LEVEL, gravity=None, load=sj.model.AppliedLoad(force=[0.0, 0.0, 50.0]), section=one)
    with pytest.warns(sj.ImplausibleWarning, match="A slipper finds no rest on the rail: start it with a motion"):
        state = sj.initial_state(off, sj.AtRest())
    assert np.isnan(float(state.motion.z))
    parts = dict(section=one, slipper=sled_on(), load=sj.model.AppliedLoad(moment=[0.0, 0.0, 0.0]))
    scene = dataclasses.replace(LEVEL, track=sj.model.TwoRails(LEVEL.track, LEVEL.track), **parts)
    turned = eqx.tree_at(lambda s: s.load.moment, scene, jnp.array([[0.0, 0.0, 0.0], [5e3, 0.0, 0.0]]))
    starts = jax.tree.map(lambda number: jnp.broadcast_to(number, 2), sj.AtRest())
    with pytest.warns(sj.ImplausibleWarning, match="A sled finds no rest on the rail, where left1 and left2 float: "):
        states = initial_states(Batched.of(turned, scene), starts)
    assert np.isfinite(states.motion.z).tolist() == [True, False]


@pytest.mark.full
def test_files_and_results_hold_a_start_at_rest(tmp_path):
    file = tmp_path / "scene.toml"
    text = LEVEL.to_toml(file, start=sj.AtRest(v_z=0.1))
    assert '[start]\ntype = "AtRest"\nv_z = "0.1 m/s"' in text
    start = sj.load(file).start
    assert isinstance(start, sj.AtRest)
    assert float(start.v_z) == 0.1
    ds = sj.run(LEVEL, length=8.0, record="peak_force")
    assert isinstance(load_base(ds)[1], sj.AtRest)
    # the highest force of the first metres is the static one
    np.testing.assert_allclose(ds["peak_force"].sum(("end", "point")), WEIGHT, rtol=1e-3)
    with pytest.raises(ValueError, match="Argument `start` must be one of rest, but is 'still'"):
        sj.simulate(LEVEL, 1, start="still")
