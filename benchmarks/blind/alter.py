"""A recorded drive as it would have been with effects in it: each written from physics, none shared with the identifier.

A sensor's effect changes its reading, exactly. A leak behind the throttle and cylinders that breathe differently change the
engine: throttle, speed, charge temperature and the pressure before the throttle stay as recorded, and the manifold pressure
settles where

    flow past the throttle + leak = flow into the cylinders,

while the fuel follows the air in the cylinders, as under mixture control. Throttle flow changes with the pressure ratio alone
(St Venant); cylinder flow changes with pressure as the recording itself shows: a thin plate through ln(W T / n) over ln p_im and
ln n. First order: what the manifold stores, a hundredth of the flow over seconds, is not drawn anew.
"""

from collections.abc import Callable, Mapping

import numpy as np
from draw import Drawn
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator, RectBivariateSpline
from scipy.ndimage import uniform_filter1d

Array = NDArray[np.float64]
Signals = dict[str, Array]
R_AIR, KAPPA = 287.0, 1.4
CLOSEST = 0.995
"""Pressure ratio beyond which the throttle is taken as open: there no flow follows from pressures."""
CLEAN_AT = 0.02
"""[kg/s], flow at which a contaminated film reads right, as the documentation of the effect says."""
HALF_SECOND, TWO_SECONDS = 11, 40
"""Samples of the recording."""
CALM = 0.7
"""Share of the blocks of two seconds that tell of the filling: those in which the pressure moves least."""
STIFF = 1.0
"""Of the thin plate: of minutes that it has not seen it tells the flow to 2.2 % (robust); a tenth makes it 1.9, and bends."""
PRESSURES, SPEEDS = np.linspace(np.log(1.2e4), np.log(2e5), 120), np.linspace(np.log(600.0), np.log(4000.0), 60)
"""Where the plate is worked out, logarithms of [Pa] and [rpm]; cubics between."""


class Drive:
    """A recorded drive, to be altered.

    Parameters
    ----------
    time : ndarray, shape (N,)
        [s], from zero.
    signals : mapping of str to ndarray, shape (N,)
        SI, speed in rpm, opening in %.
    filling : callable
        Returns ln(W T / n) of the engine, but for a constant, at pressures [Pa] and speeds [rpm].
    """

    def __init__(self, time: Array, signals: Mapping[str, Array], filling: "Filling | None" = None) -> None:
        self.time, self.recorded, self._filling = time, dict(signals), filling or filling_of(signals)

    def altered(self, effects: list[Drawn]) -> Signals:
        """Return the signals with effects in them, in the order of `EFFECTS`."""
        x = dict(self.recorded)
        for effect in sorted(effects, key=lambda effect: list(EFFECTS).index(_family(effect))):
            changed = EFFECTS[_family(effect)](self, x, effect)
            on = self._acts(effect)
            x = x | {name: np.where(on, values, x[name]) for name, values in changed.items()}
        return x

    def settled(self, x: Signals, area: float, breathing: float) -> Signals:
        """Return flow, manifold pressure and fuel with a leak [m^2] and with cylinders that take a multiple of the air."""
        p, p_ic, n = x["p_im"], x["p_ic"], x["n_e"]
        flow = np.maximum(uniform_filter1d(x["W_maf"], HALF_SECOND), 1e-4)
        through, drawn = self._through(p / p_ic), self._filling

        def passed(z: Array) -> Array:
            return self._through(p * np.exp(z) / p_ic) / through

        def taken(z: Array) -> Array:
            return breathing * np.exp(drawn(p * np.exp(z), n) - drawn(p, n))

        low, high = np.full(p.size, -0.7), np.log(np.maximum(1.2, CLOSEST * p_ic / p))
        for _ in range(40):
            z = 0.5 * (low + high)
            rises = flow * passed(z) + area * self._leak(x, p * np.exp(z)) > flow * taken(z)
            low, high = np.where(rises, z, low), np.where(rises, high, z)
        return {"W_maf": x["W_maf"] * passed(z), "p_im": p * np.exp(z), "m_f": x["m_f"] * taken(z)}

    @staticmethod
    def _through(ratio: Array) -> Array:
        """Return St Venant's flow function of the pressure ratio behind over before."""
        r = np.clip(ratio, (2.0 / (KAPPA + 1.0)) ** (KAPPA / (KAPPA - 1.0)), CLOSEST)
        return np.asarray(np.sqrt(2.0 * KAPPA / (KAPPA - 1.0) * (r ** (2.0 / KAPPA) - r ** (1.0 + 1.0 / KAPPA))))

    def _leak(self, x: Signals, p: Array) -> Array:
        """Return the flow into the manifold per area of a hole [kg/(s m^2)]: out of it under boost."""
        inward = x["p_amb"] / np.sqrt(R_AIR * x["T_amb"]) * self._through(p / x["p_amb"])
        outward = p / np.sqrt(R_AIR * x["T_ic"]) * self._through(x["p_amb"] / p)
        # Within half a per cent of equal pressures the flow passes through zero in a straight line.
        ends = np.clip((1.0 - p / x["p_amb"]) / (1.0 - CLOSEST), -1.0, 1.0)
        return np.asarray(np.where(ends > 0, inward, outward) * ends)

    def _acts(self, effect: Drawn) -> NDArray[np.bool_]:
        t = self.time
        if "episodes" in effect:
            return np.any([(t >= a) & (t < b) for a, b in effect["episodes"]], axis=0)
        return np.asarray((t >= effect.get("onset", 0.0)) & (t < effect.get("end", np.inf)))


Filling = Callable[[Array, Array], Array]


def filling_of(signals: Mapping[str, Array]) -> Filling:
    """Return ln(W T / n) over pressure and speed as a recording shows it in its calm blocks."""
    names, count = ("p_im", "n_e", "W_maf", "T_ic"), signals["p_im"].size // TWO_SECONDS
    blocks = np.stack([signals[name][: count * TWO_SECONDS].reshape(count, TWO_SECONDS) for name in names])
    moved = np.abs(np.log(blocks[0, :, -1] / blocks[0, :, 0]))
    p, n, flow, temperature = blocks[:, moved <= np.quantile(moved, CALM)].mean(2)
    plate = RBFInterpolator(np.stack([np.log(p), np.log(n)], 1), np.log(flow * temperature / n), smoothing=STIFF)
    nodes = np.stack(np.meshgrid(PRESSURES, SPEEDS, indexing="ij"), -1).reshape(-1, 2)
    surface = RectBivariateSpline(PRESSURES, SPEEDS, plate(nodes).reshape(PRESSURES.size, SPEEDS.size))
    return lambda p, n: np.asarray(surface.ev(np.log(p), np.log(n)))


def _family(effect: Drawn) -> str:
    return str(effect["id"]).split(":")[0]


def _lagged(drive: Drive, x: Signals, effect: Drawn) -> Signals:
    """Return the answer of a film with one time constant: exact for a flow that is straight between samples, means of two taken."""
    flow, begin = x["W_maf"], int(np.searchsorted(drive.time, float(effect.get("onset", 0.0))))
    kept = np.exp(-np.diff(drive.time) / float(effect["tau"]))
    out = flow.copy()
    for k in range(begin + 1, flow.size):
        out[k] = kept[k - 1] * out[k - 1] + (1.0 - kept[k - 1]) * 0.5 * (flow[k - 1] + flow[k])
    return {"W_maf": out}


def _contaminated(_: Drive, x: Signals, effect: Drawn) -> Signals:
    """Return what a dirty film reads: King's law E^2 = A + B sqrt(W) with a smaller B, and A so that it reads right at one flow."""
    lost = effect["coefficient"]
    before = np.sqrt(np.maximum(x["W_maf"], 0.0))
    return {"W_maf": (before - lost * (before - np.sqrt(CLEAN_AT))) ** 2}


def _following(x: Signals, effect: Drawn, course: Array | float) -> Signals:
    change = effect["amplitude"] * np.asarray(course)
    return {"W_maf": x["W_maf"] + change if effect["form"] == "additive" else x["W_maf"] * (1.0 + change)}


def _of_channel(_: Drive, x: Signals, effect: Drawn) -> Signals:
    course = x[str(effect["id"]).split(":")[1]]
    return _following(x, effect, course - np.median(course))


def _times(name: str) -> "Alteration":
    return lambda _, x, effect: {name: x[name] * effect["factor"]}


def _plus(name: str) -> "Alteration":
    return lambda _, x, effect: {name: x[name] + effect["offset"]}


Alteration = Callable[[Drive, Signals, Drawn], Signals]
EFFECTS: dict[str, Alteration] = {
    "leak.intake": lambda drive, x, effect: drive.settled(x, effect["area"], 1.0),
    "eta_vol.factor": lambda drive, x, effect: drive.settled(x, 0.0, effect["factor"]),
    "unlogged": lambda _, x, effect: _following(x, effect, 1.0),
    "channel": _of_channel,
    "maf.contamination": _contaminated,
    "maf.lag": _lagged,
    "maf.gain": _times("W_maf"),
    "maf.drift": lambda drive, x, effect: {"W_maf": x["W_maf"] * (1.0 + effect["rate"] * drive.time)},
    "maf.offset": _plus("W_maf"),
    "maf.delay": lambda drive, x, effect: {"W_maf": np.interp(drive.time - effect["delay"], drive.time, x["W_maf"])},
    "p_im.gain": _times("p_im"),
    "p_im.offset": _plus("p_im"),
    "p_ic.gain": _times("p_ic"),
    "p_ic.offset": _plus("p_ic"),
    "alpha_th.offset": _plus("alpha_th"),
    "u_delta.gain": _times("m_f"),  # the fuel as logged
}
"""In the order in which they come in: what changes the engine, then what changes readings."""
