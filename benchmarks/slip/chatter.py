"""Does what the model leaves out grow with the speed at which the gap closes?

    python -m benchmarks.slip.chatter > benchmarks/slip/chatter.txt

takes some minutes. `backlash` is fitted to the harmonic records of 36 lbf as in
`benchmarks.slip.run`. Each time its force has built up to `BUILT` of slip, the speed is noted, and
of the record at its full rate the root mean square residual and the overshoot (largest force over
the model's) in the next `WINDOW` s, or until the motion turns. Shown are means by record and
direction, and the slope of each against the speed with its standard error.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import numpy as np
import pandas as pd

from benchmarks.slip.run import HARMONIC, QUAKES, STARTS, by_start, fit, mechanism, read, thinned
from mfd_bayes.records.trace import Trace

BUILT, WINDOW = 0.9, 0.15
DIRECTIONS = {1.0: "forward", -1.0: "backward"}


def events(t, x, force, modelled, slip):
    """Direction, speed, residual's root mean square and overshoot after each build-up."""
    step, v = np.median(np.diff(t)), np.gradient(x, t)
    smooth = np.convolve(v, np.ones(31) / 31, mode="same")
    rows = []
    for sign, level in slip.items():
        built = sign * modelled > BUILT * level
        for k in np.flatnonzero(built[1:] & ~built[:-1] & (sign * smooth[1:] > 0.05)):
            end = min(k + int(WINDOW / step), t.size)
            turned = np.flatnonzero(sign * smooth[k:end] <= 0.0)
            end = k + turned[0] if turned.size else end
            if end - k > 0.02 / step:
                off = force[k:end] - modelled[k:end]
                over = (sign * force[k:end]).max() - (sign * modelled[k:end]).max()
                rows.append((DIRECTIONS[sign], abs(smooth[k]), np.sqrt(np.mean(off**2)), over))
    return rows


def main():
    options = common.begin(common.parser_of(__doc__, data=True))
    whole = read(options.data)
    records = thinned(whole)
    backlash, rng = mechanism("backlash"), np.random.default_rng(options.seed)
    names = HARMONIC[-2:] if options.quick else HARMONIC
    fitted = [records[name] for name in names]
    coordinates, offset, _ = fit(backlash, fitted, np.zeros(len(backlash.names)), rng)
    values = dict(zip(backlash.names, backlash.values(coordinates), strict=True))
    slip = {1.0: values["Fc_fwd"], -1.0: values["Fc_bwd"]}
    theta, lines = backlash.values(coordinates)[None], []
    for name in (*HARMONIC, *QUAKES):
        t, x, force = whole[name]
        start = STARTS[np.argmin(by_start(backlash, coordinates, offset, records[name])[1])]
        trace = Trace.from_arrays(t, x, actuation=1.0)
        modelled = backlash.model.force(theta, trace, start)[0]
        lines += [(name, *row) for row in events(t, x, force - offset, modelled, slip)]
    table = pd.DataFrame(lines, columns=["record", "direction", "speed", "rms", "overshoot"])
    means = table.groupby(["record", "direction"]).mean()
    means["closings"] = table.groupby(["record", "direction"]).size()
    print(means.to_string(float_format="%.3f"))
    for direction, rows in table.groupby("direction"):
        for kind in ("rms", "overshoot"):
            (slope, at_rest), covariance = np.polyfit(rows["speed"], rows[kind], 1, cov=True)
            print(f"{direction}: {kind} {at_rest:.3f} kip and {slope:+.4f} ± "
                  f"{np.sqrt(covariance[0, 0]):.4f} kip for each in/s, correlation "
                  f"{rows['speed'].corr(rows[kind]):.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
