"""Time integration beside closed forms and solve_ivp; energy, and draws that are named."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.response.building import Building, Device
from mfd_bayes.response.damping import damping_matrix
from mfd_bayes.response.devices import Dampers
from mfd_bayes.response.draws import no_dampers, plain_friction
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.integration import integrate
from mfd_bayes.response.modes import modes_of
from mfd_bayes.response.pace import spare_halvings
from mfd_bayes.response.schema import Damping, Limits
from mfd_bayes.response.settling import Accuracy, settle
from mfd_bayes.response.structures import Skeleton

RATIO = 0.05


def shear_building(storeys=3, devices=(), stiffness=100.0, yields=np.inf):
    """Equal storeys with 5 % in every mode."""
    drifts = np.eye(storeys) - np.eye(storeys, k=-1)
    mass, springs = 0.2 * np.eye(storeys), np.full(storeys, stiffness)
    frame = Skeleton(
        *(mass, drifts.T @ np.diag(springs) @ drifts, 0 * mass, np.ones(storeys), drifts),
        *(np.full(storeys, 144.0), np.full(storeys, yields), springs),
    )
    modes = modes_of(frame.mass, frame.stiffness)
    damping = damping_matrix(Damping(kind="modal", ratio=RATIO), frame, modes, "")
    return Building(
        *("shear building", mass, damping, frame.stiffness, frame.influence, drifts),
        *(frame.heights, frame.yields, springs, tuple(devices), Limits()),
    )


def devices(storeys, brace=np.inf):
    return [Device(f"storey {i}", i, i - 1, 1.0, "ksi", 1.0, brace) for i in range(1, storeys + 1)]


def shaking(samples=100, seed=1, peak=150.0):
    white = np.random.default_rng(seed).standard_normal(samples)
    values = np.convolve(white, np.hanning(7), mode="same")
    return Ground("random", 0.02, peak * values / np.abs(values).max())


def bouc_wen(n, m, slip=8.0, spread=0.1, seed=2):
    rng = np.random.default_rng(seed)
    row = np.array([80.0, 0.02, slip, slip, 0.6, 1.5, 0.02])
    theta = np.broadcast_to(row, (n, m, 7)).copy()
    theta[..., 2:4] *= np.exp(spread * rng.standard_normal((n, m, 1)))
    return Dampers(BoucWen(), theta, np.full((n, m), 0.5), theta[..., 2])


def test_a_linear_building_follows_the_closed_form_of_its_modes():
    building = shear_building()
    ground = Ground("constant", 0.02, np.full(300, 40.0))
    found = integrate(building, ground, no_dampers(), 1)
    modes, t = building.modes, ground.time[:, None]
    omega = modes.frequencies
    own = omega * np.sqrt(1 - RATIO**2)
    wave = np.cos(own * t) + RATIO / np.sqrt(1 - RATIO**2) * np.sin(own * t)
    share = modes.shapes.T @ building.mass @ building.influence
    q = -40.0 * share / omega**2 * (1 - np.exp(-RATIO * omega * t) * wave)
    drift = q @ modes.shapes.T @ building.drifts.T
    assert np.abs(found.drifts[0] - drift).max() < 1e-6 * np.abs(drift).max()  # stored as float32
    assert found.peaks.drift[0] == pytest.approx(np.abs(drift).max(axis=0), rel=1e-8)


def test_free_vibration_has_the_decrement_of_its_damping():
    building = shear_building(1, stiffness=20.0)
    values = np.zeros(2000)
    values[1:4] = 100.0
    ground = Ground("pulse", 0.005, values)
    x = integrate(building, ground, no_dampers(), 1).drifts[0, :, 0]
    tops = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] > x[2:])) + 1
    decrement = np.log(x[tops[0]] / x[tops[3]]) / 3
    assert decrement == pytest.approx(2 * np.pi * RATIO / np.sqrt(1 - RATIO**2), rel=2e-3)


@pytest.mark.parametrize("brace", [np.inf, 60.0])
def test_energy_is_accounted_for(brace):
    building = shear_building(3, devices(3, brace), yields=25.0)
    found = integrate(building, shaking(peak=300.0), bouc_wen(3, 3), 3)
    assert found.imbalance.max() < 1e-3
    assert found.energies.dampers.min() > 0
    assert found.energies.yielding.max() > 0
    assert np.all(found.open == 0)


def test_a_storey_that_yields_holds_no_more_than_its_strength():
    ground, slow = shaking(peak=300.0), Accuracy(tolerance=0.005)
    weak = settle(shear_building(1, yields=15.0), ground, no_dampers(), slow)
    strong = settle(shear_building(1), ground, no_dampers(), slow)
    # inertia and damping alone balance the spring's force
    assert weak.peaks.base_shear[0] < 21.0 < 0.6 * strong.peaks.base_shear[0]


def test_a_stiff_brace_is_a_rigid_one():
    ground = shaking()
    rigid = integrate(shear_building(2, devices(2)), ground, bouc_wen(2, 2), 2)
    stiff = integrate(shear_building(2, devices(2, 1e7)), ground, bouc_wen(2, 2), 2)
    soft = integrate(shear_building(2, devices(2, 40.0)), ground, bouc_wen(2, 2), 2)
    assert np.allclose(stiff.peaks.drift, rigid.peaks.drift, rtol=1e-4)
    assert np.all(soft.peaks.travel < rigid.peaks.travel)


def test_plain_friction_slips_at_its_force():
    building = shear_building(2, devices(2))
    found = settle(building, shaking(), plain_friction(np.array([6.0, 4.0])), Accuracy())
    assert found.peaks.force[0] == pytest.approx([6.0, 4.0])
    assert not found.unstable.any()


@pytest.mark.parametrize(
    "name", ["lugre", "bouc_wen", "backlash", pytest.param("three_stage", marks=pytest.mark.slow)]
)
def test_one_storey_agrees_with_solve_ivp(benchmark_module, name):
    cases = benchmark_module("response.cases")
    errors, ours = cases.compared(name, 1, 90, Accuracy(tolerance=0.002, halvings=5))
    assert errors.max() < 0.005
    assert ours.peaks.travel[0, 0] > 0.02


def test_draws_do_not_meet_each_other():
    building, ground, dampers = shear_building(2, devices(2)), shaking(), bouc_wen(6, 2)
    together = integrate(building, ground, dampers, 2)
    alone = integrate(building, ground, dampers.chosen(np.array([4])), 2)
    assert alone.peaks.drift[0] == pytest.approx(together.peaks.drift[4], rel=1e-6)


def test_a_draw_that_is_left_out_when_it_is_in_equilibrium_stays_right():
    building, ground = shear_building(2, devices(2)), shaking(40)
    dampers = bouc_wen(120, 2)  # enough that draws are left out of iterations
    together = integrate(building, ground, dampers, 2, kept=120)
    rows = np.array([0, 57, 119])
    alone = integrate(building, ground, dampers.chosen(rows), 2, kept=3)
    assert np.allclose(together.forces[rows], alone.forces, atol=1e-4)
    assert np.allclose(together.travels[rows], alone.travels, atol=1e-5)


def test_a_draw_that_runs_away_is_named():
    building = shear_building(1, devices(1))
    drive = bouc_wen(3, 1)
    drive.theta[1, 0, 6] = 1e9  # a dashpot beyond all reason
    pushing = replace(drive, theta=drive.theta.copy())
    found = settle(building, shaking(peak=1e9), pushing, Accuracy(halvings=1))
    assert found.unstable[0]
    assert np.all(np.isfinite(found.peaks.drift[~found.unstable]))


def quiet_after(samples=200, loud=100):
    """Shaking that falls to a fiftieth."""
    ground = shaking(samples, peak=300.0)
    fade = np.where(np.arange(samples) < loud, 1.0, 0.02)
    return replace(ground, acceleration=ground.acceleration * fade)


def test_steps_are_longer_where_forces_bend_little():
    building, ground = shear_building(2, devices(2)), quiet_after()
    spare = spare_halvings(building, ground, bouc_wen(4, 2))
    assert spare[:95].mean() < 0.5 < 1.0 < spare[150:].mean()
    assert set(spare) <= {0, 1, 2}
    yielding = shear_building(2, devices(2), yields=25.0)
    assert not spare_halvings(yielding, ground, bouc_wen(4, 2)).any()


def test_uneven_steps_give_the_history_of_even_ones():
    building, ground, dampers = shear_building(2, devices(2)), quiet_after(), bouc_wen(4, 2)
    parts = np.maximum(8 >> spare_halvings(building, ground, dampers), 1)
    uneven = integrate(building, ground, dampers, parts)
    even = integrate(building, ground, dampers, 8)
    assert np.unique(parts).size > 1
    assert np.all(uneven.peaks.change_from(even.peaks) < 2e-3)
    assert np.allclose(uneven.residual, even.residual, atol=2e-3 * np.abs(even.drifts).max())
    assert np.allclose(uneven.drifts, even.drifts, atol=4e-3 * np.abs(even.drifts).max())
    assert uneven.imbalance.max() < 1e-3
    assert uneven.step == pytest.approx(ground.step / 8)


def test_peaks_of_force_are_looked_for_within_steps_too(monkeypatch, benchmark_module):
    row_of = benchmark_module("response.cases").three_stage_row
    rng, shape = np.random.default_rng(5), (6, 1)
    theta = np.array([[row_of(rng, 8.0)] for _ in range(6)])
    dampers = Dampers(ThreeStage(), theta, np.full(shape, 0.5), np.full(shape, 8.0))
    building, ground = shear_building(1, devices(1)), shaking(peak=300.0)
    fine = integrate(building, ground, dampers, 32).peaks.force

    def error():
        force = integrate(building, ground, dampers, 2).peaks.force
        return np.abs(force / fine - 1.0).mean()

    within = error()
    at_ends = "mfd_bayes.response.integration._Mover._middle"
    monkeypatch.setattr(at_ends, lambda mover, before, state, force, step: force)
    assert within < 0.7 * error()


def three_stages(starts):
    """Dampers that begin at places (n, m); those of the first draw are alike in both directions."""
    known = dict.fromkeys(("Fs_fwd", "Fs_bwd"), 6.0) | dict.fromkeys(("Fc_fwd", "Fc_bwd"), 5.0)
    known |= {"sigma0": 100.0, "sigma1": 0.1, "sigma2": 0.02, "v_s": 1.0, "k2": 1.0, "k3": 30.0}
    known |= {"d2": 0.1, "d3": 0.1, "gamma1": 1.0, "gamma2": 0.02}
    start, model = np.array(starts), ThreeStage()
    row = np.array([known[name] for name in model.parameters])
    theta = np.broadcast_to(row, (*start.shape, row.size)).copy()
    theta[1:, :, model.parameters.index("Fc_bwd")] = 3.0  # but for the others
    return Dampers(model, theta, start, np.full(start.shape, 5.0))


def test_the_mirrored_earthquake_has_the_mirrored_response():
    building, ground = shear_building(2, devices(2)), shaking()
    mirrored = replace(ground, acceleration=-ground.acceleration)
    one, other = (
        integrate(building, g, three_stages(np.full((2, 2), 0.5)), 4) for g in (ground, mirrored)
    )
    assert np.allclose(one.drifts[0], -other.drifts[0], atol=1e-5)
    assert not np.allclose(one.drifts[1], -other.drifts[1], atol=1e-2)  # the control


def test_kept_forces_begin_with_that_at_rest():
    ground, dampers = shaking(), three_stages([[0.98], [0.5]])
    found = integrate(shear_building(1, devices(1)), ground, dampers, 2, kept=2)
    at_rest = dampers.towards(-np.sign(ground.acceleration[:1])).bank().force
    assert np.max(np.abs(at_rest)) > 1.0
    assert np.allclose(found.forces[:, 0, 0], at_rest, rtol=1e-5)
