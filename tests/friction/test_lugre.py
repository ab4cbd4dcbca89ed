import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mfd_bayes.friction.three_stage import LuGre
from mfd_bayes.records.trace import Trace

NAMES = ("sigma0", "sigma1", "sigma2", "Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd", "v_s")
VALUES = dict(zip(NAMES, (40.0, 0.03, 0.02, 2.4, 2.0, 1.9, 1.5, 0.5), strict=True))


def theta(**changes):
    values = VALUES | changes
    return np.array([[values[name] for name in LuGre().parameters]])


def stribeck(velocity, values=VALUES):
    side = "fwd" if velocity >= 0 else "bwd"
    static, kinetic = values[f"Fs_{side}"], values[f"Fc_{side}"]
    return kinetic + (static - kinetic) * np.exp(-((velocity / values["v_s"]) ** 2))


def test_exact_step_equals_a_stiff_solver_while_the_velocity_is_constant():
    for velocities in [(0.3, -0.3), (3.0, -1.0, 0.2), (-0.05, 0.4, -4.0)]:
        rate, samples = 50.0, 20
        time, motion, states = [0.0], [0.0], [0.0]
        for v in velocities:
            span = np.arange(1, samples + 1) / rate
            level = stribeck(v)

            def slope(_, z, v=v, level=level):
                return v - VALUES["sigma0"] * abs(v) * z / level

            options = {"method": "Radau", "t_eval": span, "rtol": 1e-11, "atol": 1e-14}
            leg = solve_ivp(slope, (0, span[-1]), [states[-1]], **options)
            time.extend(time[-1] + span)
            motion.extend(motion[-1] + v * span)
            states.extend(leg.y[0])
        bristles = theta(sigma1=0.0, sigma2=0.0)
        force = LuGre().force(bristles, Trace.from_arrays(time, motion))[0]
        np.testing.assert_allclose(force, VALUES["sigma0"] * np.array(states), rtol=1e-7, atol=1e-9)


def test_a_sample_without_a_step_keeps_the_bristles_and_has_its_rate_terms():
    for velocity in [0.2, -0.2]:
        for way in [0.02, -0.02]:
            # forward or backward, then at the same place with a velocity that is still measured
            time = np.array([0.0, 0.1, 0.2])
            trace = Trace.from_arrays(time, [0.0, way, way], velocity=[0.0, 0.0, velocity])
            elastic, force = (
                LuGre().force(theta(sigma1=sigma1, sigma2=0.0), trace)[0] for sigma1 in (0.0, 0.03)
            )
            assert elastic[2] == elastic[1]
            z = elastic[1] / VALUES["sigma0"]
            rate = velocity - VALUES["sigma0"] * abs(velocity) * z / VALUES["Fs_fwd"]
            assert force[2] == pytest.approx(elastic[2] + 0.03 * rate, rel=1e-9)
