"""What noise makes of the products of slopes and readings, against the covariance that it has in a drive that stands still."""

import numpy as np
import pytest

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.unknowns import unknowns_of
from lpvobs.observer.parts import Answers, parted, slope_signals
from lpvobs.observer.smoothing import roughness, smooth
from lpvobs.observer.windows import LENGTH

STILL = {
    "n_e": 1800.0, "u_delta": 25.0, "u_egr": 8.0, "u_vgt": 60.0, "p_im": 1.6e5, "p_em": 1.9e5, "omega_t": 14000.0,
    "T_im": 320.0, "T_em": 650.0, "T_ports": 650.0, "p_amb": 98000.0, "T_amb": 298.0, "W_maf": 0.07,
}  # fmt: skip
NOISE = {"p_im": 150.0, "p_em": 300.0, "omega_t": 20.0, "T_im": 0.3, "T_em": 2.0}


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_what_is_taken_off_is_the_covariance_that_noise_makes(engine, grid, settings, step):
    diesel = Diesel(engine)
    N = round(1500.0 / step)
    rng = np.random.default_rng(1)
    recorded = {k: v + NOISE.get(k, 0.0) * rng.standard_normal(N) for k, v in STILL.items()}
    segments = ((0, N),)
    time = step * np.arange(N)
    columns = np.stack([recorded[name] for name in diesel.smoothed])
    values, rates = smooth(time, columns, segments, settings.smoothing)
    seen = {**recorded, **dict(zip(diesel.smoothed, values, strict=True))}
    rate = dict(zip(diesel.smoothed, rates, strict=True))
    rough = {name: roughness(recorded[name], segments) for name in diesel.noisy}
    signals = slope_signals(diesel, seen, rate, rough, np.full(N, step))
    per = round(LENGTH / step)
    means = signals[:, per : N - N % per].reshape(len(signals), -1, per).mean(axis=2).T[:-1]
    answers = Answers(diesel, unknowns_of(settings.tolerance, diesel.components), settings)
    found = answers.slopes(np.full(len(means), LENGTH), means)
    (channels, mean_rates, _), _ = parted(diesel, means)
    _, _, flow = answers._at(channels, mean_rates)
    J, z = found.J - found.J.mean(axis=0), flow.mean(axis=0) - flow
    dJ, dz = found.shaken
    n = len(means)
    for b in range(2):
        at_random, taken = J[:, b] * z[:, b, None], dJ[:, b] * dz[:, b, None]
        error = at_random.std(axis=0) / np.sqrt(n)  # neighbouring windows share little
        size = np.abs(at_random.mean(axis=0))
        clear = size > 10.0 * error
        assert clear.any()
        # at 100 Hz a window's mean has a tenth less noise than its samples say: neighbours share what they smooth
        np.testing.assert_allclose(taken.mean(axis=0)[clear], at_random.mean(axis=0)[clear], rtol=0.25)
