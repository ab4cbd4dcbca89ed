import numpy as np
import pytest

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import turning_points
from mfd_bayes.records.trace import Trace

TIME = np.linspace(0, 10, 1001)
MOTION = np.sin(2 * np.pi * 0.5 * TIME)


def test_velocity_is_the_central_difference_when_not_given():
    trace = Trace.from_arrays(TIME, MOTION)
    np.testing.assert_allclose(trace.velocity, np.pi * np.cos(np.pi * TIME), atol=0.06)
    given = Trace.from_arrays(TIME, MOTION, velocity=np.ones_like(TIME))
    assert np.all(given.velocity == 1)


def test_turning_points_of_a_sine_are_its_extremes():
    trace = Trace.from_arrays(TIME, MOTION)
    np.testing.assert_allclose(TIME[trace.turning_points], np.arange(0.5, 10, 1), atol=1e-9)
    assert trace.direction == 1
    assert Trace.from_arrays(TIME, -MOTION).direction == -1


def test_ripple_below_the_hysteresis_makes_no_turning_point():
    ripple = 1e-3 * np.sin(2 * np.pi * 40 * TIME)
    assert turning_points(MOTION + ripple, 0.01).size == 10
    assert turning_points(MOTION + ripple, 1e-5).size > 10


def test_of_a_plateau_the_last_sample_counts():
    motion = np.array([0, 1, 1, 1, 0, 0, 1, 1.0])
    np.testing.assert_array_equal(turning_points(motion, 0.1), [3, 5])


def test_turning_points_alternate_on_a_random_walk():
    walk = np.cumsum(np.random.default_rng(3).normal(size=5000))
    turns = turning_points(walk, 5.0)
    legs = np.diff(walk[turns])
    assert turns.size > 10
    assert np.all(np.abs(legs) > 5)
    assert np.all(legs[1:] * legs[:-1] < 0)


def test_arrays_are_copied_and_cannot_be_written():
    motion = MOTION.copy()
    trace = Trace.from_arrays(TIME, motion)
    motion[:] = 0
    assert trace.displacement[50] == pytest.approx(1)
    with pytest.raises(ValueError, match="read-only"):
        trace.displacement[0] = 1


def test_actuation_is_a_level_or_a_history():
    level = Trace.from_arrays(TIME, MOTION, actuation=0.8)
    assert (level.actuation, level.varying, level.reference_actuation) == (0.8, False, 0.8)
    history = Trace.from_arrays(TIME, MOTION, actuation=np.linspace(0, 1, TIME.size))
    assert history.varying
    assert history.reference_actuation == pytest.approx(0.5)
    assert np.isnan(Trace.from_arrays(TIME, MOTION).reference_actuation)


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"time": [0, 1], "displacement": [0, 1]}, "at least 3"),
        ({"time": [0, 1, 1], "displacement": [0, 1, 2]}, "sample 2"),
        ({"time": [0, 1, 2], "displacement": [0, 1]}, "3 samples"),
        ({"time": [0, 1, 2], "displacement": [0, np.nan, 1]}, "finite"),
        ({"time": [0, 1, 2], "displacement": [[0, 1, 2]]}, "one-dimensional"),
        ({"time": [0, 1, 2], "displacement": [0, 1, 2], "actuation": -1}, "not negative"),
        ({"time": [0, 1, 2], "displacement": [0, 1, 2], "actuation": [0, -1, 0]}, "negative"),
        ({"time": [0, 1, 2], "displacement": [0, 1, 2], "force": [0]}, "force"),
    ],
)
def test_bad_arrays_are_refused(arrays, expected):
    with pytest.raises(RecordError, match=expected):
        Trace.from_arrays(**arrays)


def test_noise_of_a_sensor_makes_no_turns():
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 12.0, 0.01)
    clean = 20.0 * np.sin(2 * np.pi * 0.25 * time)
    noisy = clean + 0.02 * rng.standard_normal(time.size)  # 0.05 % of the stroke
    found, wanted = (Trace.from_arrays(time, x).turning_points for x in (noisy, clean))
    assert found.size == wanted.size == 6
    assert np.all(np.abs(found - wanted) < 10)


def test_a_coarse_smooth_motion_keeps_its_small_turns():
    time = np.arange(0.0, 12.0, 0.05)
    small = np.where(time < 6.0, 1.0, 0.004)  # turns of 0.4 % of the stroke, 10 samples apart
    motion = Trace.from_arrays(time, small * np.sin(2 * np.pi * time))
    assert motion.turning_points.size >= 22
    assert motion.hysteresis == pytest.approx(1e-3 * np.ptp(motion.displacement))
