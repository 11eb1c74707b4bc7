"""`/engine`: what healthy logs have taught of a throttled engine and its errors, so that `trace` needs none of them."""

import h5py
import numpy as np

from lpvobs.discovery.throttled_noise import HealthyErrors
from lpvobs.engines.throttled.balances import BALANCES
from lpvobs.engines.throttled.constants import Learned, ThrottledEngine
from lpvobs.errors import DataError
from lpvobs.io.results.hdf import Field, numbers, text, write_group

GROUP = "engine"


def write_learned(file: h5py.File, engine: ThrottledEngine, learned: Learned, healthy: HealthyErrors) -> None:
    """Write `/engine` into a result that has none."""
    nodes, spread = engine.curves, np.sqrt(np.diag(learned.covariance))
    part = {name: spread[where] for name, where in learned.deviations().items()}
    group = file.create_group(GROUP)
    group.attrs["logs"] = " ".join(learned.sources)
    write_group(
        group,
        "throttle",
        {
            "alpha_th": Field(np.array(nodes.alpha_th), "%", "throttle opening"),
            "area": Field(learned.area, "m^2", "effective area", ("alpha_th",)),
            "relative_error": Field(part["throttle"], "1", "standard error of the area over the area", ("alpha_th",)),
        },
    )
    write_group(
        group,
        "filling",
        {
            "n_e": Field(np.array(nodes.n_e), "rpm", "engine speed"),
            "p_im": Field(np.array(nodes.p_im), "Pa", "intake manifold pressure"),
            "eta_vol": Field(learned.eta_vol, "1", "volumetric efficiency", ("n_e", "p_im")),
            "relative_error": Field(
                part["filling"].reshape(learned.eta_vol.shape), "1", "standard error of it over it", ("n_e", "p_im")
            ),
        },
    )
    write_group(
        group,
        "fuel",
        {
            "m_f": Field(np.array(nodes.m_f), "1", "fuel reading per stroke"),
            "n_e": Field(np.array(nodes.fuel_n_e), "rpm", "engine speed"),
            "air": Field(learned.fuel, "kg", "air in a cylinder per unit of the fuel reading", ("m_f", "n_e")),
            "relative_error": Field(
                part["fuel"].reshape(learned.fuel.shape), "1", "standard error of it over it", ("m_f", "n_e")
            ),
        },
    )
    _write_rest(group, learned, healthy)


def _write_rest(group: h5py.Group, learned: Learned, healthy: HealthyErrors) -> None:
    size = learned.covariance.shape[0]
    classes = healthy.scale.shape[0]
    write_group(
        group,
        "volumes",
        {
            "V_ic": Field(learned.V_ic, "m^3", "volume before the throttle"),
            "V_im": Field(learned.V_im, "m^3", "volume behind the throttle"),
            "deviation": Field(np.arange(size, dtype=np.int32), "1", "throttle, filling, fuel, V_ic, V_im"),
            "other_deviation": Field(np.arange(size, dtype=np.int32), "1", "the same"),
            "covariance": Field(
                learned.covariance, "1", "covariance of all relative deviations", ("deviation", "other_deviation")
            ),
        },
    )
    write_group(
        group,
        "healthy_errors",
        {
            "balance": Field(text(BALANCES), "1", "balance"),
            "flow_balance": Field(text(BALANCES[:3]), "1", "balance"),
            "other_flow_balance": Field(text(BALANCES[:3]), "1", "balance"),
            "level": Field(np.arange(classes, dtype=np.int32), "1", "class of haste"),
            "bound": Field(np.arange(classes - 1, dtype=np.int32), "1", "between two classes"),
            "hurry": Field(healthy.hurry, "1", "haste at the bounds", ("bound",)),
            "scale": Field(healthy.scale, "1", "scale of the relative residual, held out", ("level", "balance")),
            "together": Field(
                healthy.together,
                "1",
                "second moments of residual over scale",
                ("flow_balance", "other_flow_balance"),
            ),
            "slow": Field(healthy.slow, "1", "standard deviation of what lasts for minutes", ("balance",)),
            "rms": Field(healthy.rms, "1", "rms of the relative residual, held out", ("balance",)),
            "calm_flow": Field(healthy.calm_flow, "kg/s", "below it p_ic is compared with p_amb"),
        },
    )


def read_learned(file: h5py.File) -> tuple[Learned, HealthyErrors]:
    """Return what `/engine` of an open result holds; raises DataError where there is none."""
    if GROUP not in file:
        raise DataError(f"{file.filename}: has no learned engine; make it with `lpvobs estimate` from a healthy log")
    group = file[GROUP]
    own, errors = group["volumes"], group["healthy_errors"]
    learned = Learned(
        area=group["throttle/area"][()],
        eta_vol=group["filling/eta_vol"][()],
        fuel=group["fuel/air"][()],
        V_ic=float(own["V_ic"][()]),
        V_im=float(own["V_im"][()]),
        covariance=own["covariance"][()],
        sources=tuple(str(group.attrs["logs"]).split()),
    )
    scale = errors["scale"][()]
    healthy = HealthyErrors(
        hurry=numbers(errors, "hurry", scale.shape[0] - 1),
        scale=scale,
        together=numbers(errors, "together", 3, 3),
        slow=numbers(errors, "slow", 4),
        rms=numbers(errors, "rms", 4),
        calm_flow=float(errors["calm_flow"][()]),
    )
    return learned, healthy
