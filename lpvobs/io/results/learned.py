"""`/engine`: what healthy logs have taught of a throttled engine and its errors, so that `trace` needs none of them."""

from typing import Any

import h5py
import numpy as np

from lpvobs.discovery.throttled_noise import HealthyErrors
from lpvobs.engines.throttled.balances import BALANCES
from lpvobs.engines.throttled.constants import Learned, ThrottledEngine
from lpvobs.errors import DataError
from lpvobs.io.results.hdf import Field, write_group
from lpvobs.io.results.mapping import Item, Layout, fields, read, values

GROUP = "engine"
SPEED = Item("rpm", "engine speed")
DEVIATIONS = "throttle, filling, fuel, V_ic, V_im"

CURVES = {
    "throttle": Layout(
        Learned,
        {"area": Item("m^2", "effective area", ("alpha_th",))},
        {"alpha_th": Item("%", "throttle opening")},
    ),
    "filling": Layout(
        Learned,
        {"eta_vol": Item("1", "volumetric efficiency", ("n_e", "p_im"))},
        {"n_e": SPEED, "p_im": Item("Pa", "intake manifold pressure")},
    ),
    "fuel": Layout(
        Learned,
        {"air": Item("kg", "air in a cylinder per unit of the fuel reading", ("m_f", "n_e"), "fuel")},
        {"m_f": Item("1", "fuel reading per stroke"), "n_e": SPEED},
    ),
}
VOLUMES = Layout(
    Learned,
    {
        "V_ic": Item("m^3", "volume before the throttle"),
        "V_im": Item("m^3", "volume behind the throttle"),
        "covariance": Item("1", "covariance of all relative deviations", ("deviation", "other_deviation")),
    },
    {"deviation": DEVIATIONS, "other_deviation": DEVIATIONS},
    ("sources",),
)
HEALTHY = Layout(
    HealthyErrors,
    {
        "hurry": Item("1", "haste at the bounds", ("bound",)),
        "scale": Item("1", "scale of the relative residual, held out", ("level", "balance")),
        "together": Item("1", "second moments of residual over scale", ("flow_balance", "other_flow_balance")),
        "slow": Item("1", "standard deviation of what lasts for minutes", ("balance",)),
        "rms": Item("1", "rms of the relative residual, held out", ("balance",)),
        "calm_flow": Item("kg/s", "below it p_ic is compared with p_amb"),
    },
    {
        "balance": "balance",
        "flow_balance": "balance",
        "other_flow_balance": "balance",
        "level": "class of haste",
        "bound": "between two classes",
    },
)


def write_learned(file: h5py.File, engine: ThrottledEngine, learned: Learned, healthy: HealthyErrors) -> None:
    """Write `/engine` into a result that has none."""
    group, nodes = file.create_group(GROUP), engine.curves
    spread = np.sqrt(np.diag(learned.covariance))
    axes = {
        "throttle": {"alpha_th": nodes.alpha_th},
        "filling": {"n_e": nodes.n_e, "p_im": nodes.p_im},
        "fuel": {"m_f": nodes.m_f, "n_e": nodes.fuel_n_e},
    }
    for name, layout in CURVES.items():
        part = spread[learned.deviations()[name]].reshape([len(axis) for axis in axes[name].values()])
        error = Field(part, "1", "standard error of the curve over the curve", tuple(axes[name]))
        write_group(group, name, fields(layout, learned, axes[name]) | {"relative_error": error})
    write_group(group, "volumes", fields(VOLUMES, learned))
    flows = BALANCES[:3]
    labels = {"balance": BALANCES, "flow_balance": flows, "other_flow_balance": flows}
    write_group(group, "healthy_errors", fields(HEALTHY, healthy, labels))


def read_learned(file: h5py.File) -> tuple[Learned, HealthyErrors]:
    """Return what `/engine` of an open result holds; raises DataError where there is none."""
    if GROUP not in file:
        raise DataError(f"{file.filename}: has no learned engine; make it with `lpvobs estimate` from a healthy log")
    group = file[GROUP]
    curves: dict[str, Any] = {}
    for name, layout in CURVES.items():
        curves |= values(group[name], layout)
    return read(group["volumes"], VOLUMES, **curves), read(group["healthy_errors"], HEALTHY)
