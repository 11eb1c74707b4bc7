"""The plant along a drive: classical Runge-Kutta of fourth order at a fixed step, under the simulator's own EGR and VGT control.

The control has set-points over speed and fuel, and two PI controllers that act at a fixed period.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.engines.constants import flat, flat_type, names_of
from lpvobs.records import Array
from lpvobs.simulation import plant as relation
from lpvobs.simulation.instruments import cooler_effectiveness
from lpvobs.simulation.parameters import Control, Setpoints, SimulationParameters
from lpvobs.simulation.plant import OMEGA_T, P_EM, P_IM, T_IM, U_EGR1, U_EGR2, U_VGT, X_OEM, X_OIM, Inputs, Plant
from lpvobs.simulation.structure import Stage, compressor_stage, filling_factor, other_egr, other_turbine
from lpvobs.simulation.vehicle import interpolate


@njit(cache=True)
def flows(plant: Plant, x: Array, given: Inputs) -> relation.Flows:
    """Return flows, temperatures and powers for state x, shape (9,)."""
    # The forms of another structure are called where they are at work: a call takes along all constants of the plant.
    c, b, s = plant.engine, plant.body, plant.structure
    p_im, p_em, omega_t, T_im = x[P_IM], x[P_EM], max(x[OMEGA_T], relation.SLOWEST_TURBINE), x[T_IM]
    W_ei = relation.cylinder_flow(plant, p_im, given.n_e, T_im)
    if s.wave + s.residual_gas + s.charge_heating > 0.0:
        W_ei *= filling_factor(s, given.n_e, p_im, p_em, T_im, given.T_wall, W_ei / c.V_d, b.compression_ratio)
    u_delta = max(0.0, min(given.u_demand, relation.smoke_limit(plant, W_ei, x[X_OIM], given.n_e)))
    W_f = 1e-6 / 120.0 * u_delta * given.n_e * c.n_cyl  # Eq. (2)
    needed = W_f * b.air_fuel_stoichiometric * b.X_Oc
    lambda_O = W_ei * x[X_OIM] / needed if needed > 0.0 else 1e9  # no fuel counts as lean
    W_eo = W_ei + W_f
    T_e = relation.cylinder_out_temperature(plant, W_ei, W_f, lambda_O, p_im, p_em, T_im)
    T_em = relation.pipe_temperature(plant, T_e, W_eo, given.T_amb)
    u_egr = relation.valve_position(plant, x[U_EGR1], x[U_EGR2])
    if s.compressor + s.pipes > 0.0:
        air = compressor_stage(plant, p_im, omega_t, given.p_amb, given.T_amb, T_em)
    else:
        W_c = relation.compressor_flow(plant, p_im, omega_t, given.p_amb, given.T_amb)
        air = Stage(W_c, given.p_amb, p_im, given.T_amb, 1.0, 0.0)
    heating = relation.compressor_heating(plant, air.W_c, air.p_out, air.p_in, air.T_in, air.loss)
    warming = heating + air.warming + (air.T_in - given.T_amb)
    effectiveness = b.effectiveness_intercooler
    if s.thermocouple > 0.0:
        effectiveness = cooler_effectiveness(s.thermocouple, b.effectiveness_intercooler, given.v_air, air.W_c / c.V_d)
    if s.turbine > 0.0:
        W_t, P_t = other_turbine(plant, p_em, x[U_VGT], omega_t, T_em, W_eo, given)
    else:
        W_t, Pi_t = relation.turbine_flow(plant, p_em, x[U_VGT], T_em, given.p_amb)
        P_t = relation.turbine_power(plant, W_t, Pi_t, omega_t, T_em)
    P_t *= relation.risen(plant.condition.turbine_curve, x[U_VGT])
    if s.egr > 0.0:
        W_egr = other_egr(plant, p_im, p_em, u_egr, T_im, T_em, given.n_e, u_delta)
    else:
        W_egr = relation.egr_flow(plant, p_im, p_em, u_egr, T_im, T_em)
    W_leak = relation.intake_leak(plant, p_im, T_im, given.p_amb, given.T_amb)
    X_Oe = max(0.0, W_ei * x[X_OIM] - needed) / W_eo
    behind_cooler = (1.0 - effectiveness) * warming
    P_c = air.W_c * c.c_pa * heating  # Eq. (2)
    return relation.Flows(air.W_c, W_egr, W_ei, W_f, W_t, W_leak, u_delta, u_egr, T_em, X_Oe, behind_cooler, P_c, P_t)


@njit(cache=True)
def mixed_temperature(plant: Plant, f: relation.Flows, T_im: float, T_amb: float) -> float:
    """Return the temperature [K] of cooled charge air, cooled EGR and air from a leak together, weighted with W c_p (+)."""
    c, b = plant.engine, plant.body
    charge = T_amb + f.charge_warming
    recirculated = f.T_em - b.effectiveness_egr * (f.T_em - b.T_cool)
    air, exhaust, drawn_in = f.W_c * c.c_pa, max(f.W_egr, 0.0) * c.c_pe, max(-f.W_leak, 0.0) * c.c_pa
    if air + exhaust + drawn_in <= 0.0:
        return T_im
    return (air * charge + exhaust * recirculated + drawn_in * T_amb) / (air + exhaust + drawn_in)


@njit(cache=True)
def derivative(plant: Plant, x: Array, given: Inputs, out: Array) -> None:
    """Write dx/dt for state x, both of shape (9,), into `out`.

    Departure from the paper's Eq. (1): dp_im/dt has the term (p_im / T_im) dT_im/dt, because T_im is a state here.
    """
    c, b = plant.engine, plant.body
    f = flows(plant, x, given)
    p_im, T_im = x[P_IM], x[T_IM]
    fill = c.R_a * T_im / c.V_im
    empty = c.R_e * f.T_em / c.V_em
    dT_im = (mixed_temperature(plant, f, T_im, given.T_amb) - T_im) / b.tau_T_im
    oxygen_in = (x[X_OEM] - x[X_OIM]) * max(f.W_egr, 0.0) + (b.X_Oc - x[X_OIM]) * (f.W_c + max(-f.W_leak, 0.0))
    oxygen_out = (f.X_Oe - x[X_OEM]) * (f.W_ei + f.W_f) + (x[X_OIM] - x[X_OEM]) * max(-f.W_egr, 0.0)
    out[P_IM] = fill * (f.W_c + f.W_egr - f.W_ei - f.W_leak) + p_im / T_im * dT_im  # Eq. (1)
    out[P_EM] = empty * (f.W_ei + f.W_f - f.W_t - f.W_egr)  # Eq. (1)
    out[X_OIM] = fill / p_im * oxygen_in
    out[X_OEM] = empty / x[P_EM] * oxygen_out
    out[OMEGA_T] = (f.P_t - f.P_c) / (c.J_t * max(x[OMEGA_T], relation.SLOWEST_TURBINE))  # Eq. (1)
    out[U_EGR1] = (given.u_egr - x[U_EGR1]) / b.tau_egr1
    out[U_EGR2] = (given.u_egr - x[U_EGR2]) / b.tau_egr2
    out[U_VGT] = (given.u_vgt - x[U_VGT]) / b.tau_vgt
    out[T_IM] = dT_im


class Targets(flat_type([*names_of(Setpoints, Control), "n_cyl"])):  # type: ignore[misc]
    """Set-points and gains as the compiled functions read them."""


class Commands(NamedTuple):
    """Commanded openings [%] and the two integrators [%] that led to them."""

    u_egr: float
    u_vgt: float
    egr_integral: float
    vgt_integral: float


def targets_of(parameters: SimulationParameters, n_cyl: int) -> Targets:
    """Return set-points and gains of an engine with so many cylinders."""
    return flat(Targets, parameters.setpoints, parameters.control, n_cyl=n_cyl)


@njit(cache=True)
def look_up(rows: Array, columns: Array, values: Array, row: float, column: float) -> float:
    """Return the bilinear value of a table, held outside its axes."""
    i = min(max(int(np.searchsorted(rows, row)) - 1, 0), rows.size - 2)
    share = min(max((row - rows[i]) / (rows[i + 1] - rows[i]), 0.0), 1.0)
    low, high = interpolate(columns, values[i], column), interpolate(columns, values[i + 1], column)
    return (1.0 - share) * low + share * high


@njit(cache=True)
def control(targets: Targets, last: Commands, given: Inputs, x: Array, W_c: float) -> Commands:
    """Return the next commands, for the state x, shape (9,), and a flow W_c [kg/s]."""
    n_e, u_demand, p_im = given.n_e, given.u_demand, x[P_IM]
    # With EGR active the valve opens while there is more fresh air than wanted, and the vanes hold p_em - p_im; otherwise
    # the valve is shut and the vanes hold the boost. The integrators stop at the limits of what they drive; the valve's
    # rests while shut.
    low, high = targets.egr_off_below_u_delta, targets.egr_off_above_u_delta
    if low <= u_demand <= high and n_e <= targets.egr_off_above_n_e:
        per_stroke = look_up(targets.air_n_e, targets.air_u_delta, targets.air, n_e, u_demand)
        wanted = 1e-6 * per_stroke * n_e * targets.n_cyl / 120.0
        excess = W_c / wanted - 1.0
        moved = last.egr_integral + targets.period * targets.egr_integral * excess
        egr_integral = min(max(moved, 0.0), targets.egr_max)
        u_egr = min(max(egr_integral + targets.egr_proportional * excess, 0.0), targets.egr_max)
        missing = targets.delta_p[0] + targets.delta_p[1] * n_e - (x[P_EM] - p_im)
        kp, ki = targets.pressure_proportional, targets.pressure_integral
    else:
        egr_integral, u_egr = last.egr_integral, 0.0
        missing = look_up(targets.boost_n_e, targets.boost_u_delta, targets.boost, n_e, u_demand) * given.p_amb - p_im
        kp, ki = targets.boost_proportional, targets.boost_integral
    vgt_integral = min(max(last.vgt_integral - targets.period * ki * missing, targets.vgt_min), targets.vgt_max)
    u_vgt = min(max(vgt_integral - kp * missing, targets.vgt_min), targets.vgt_max)
    return Commands(u_egr, u_vgt, egr_integral, vgt_integral)


TRAIL = ("n_e", "u_delta", "W_c", "T_im")
"""What is kept at every step of the integrator where a sensor needs to know what has been."""
RECORDED = (*TRAIL, "u_egr", "u_vgt", "p_im", "p_em", "omega_t", "T_em", "W_egr", "W_ei", "W_leak", "warming")
CHUNK = 2000  # actions of the control between two reports of progress


class Course(NamedTuple):
    """What the engine is asked for at every action of its control, shape (M,): the first four run straight in between."""

    n_e: Array  # [rpm]
    u_demand: Array  # [mg/cycle]
    p_amb: Array  # [Pa]
    T_amb: Array  # [K]
    T_wall: Array  # [K], stands still in between, as does
    v_air: Array  # [m/s]


class Interval(NamedTuple):
    """The time between two actions of the control."""

    course: Course
    commands: Commands
    period: float  # s
    action: int  # the first of the two, after which the commands hold


class Samples(NamedTuple):
    """When to record: in which step since the start, and how long after its beginning; both of shape (N,)."""

    step: NDArray[np.int64]
    after: Array  # s


def sample_times(rate: float, duration: float, step: float) -> Samples:
    """Return the instants 0, 1/rate, ... up to the duration [s], placed among the integrator's steps."""
    time = np.arange(int(np.floor(duration * rate + 1e-9)) + 1) / rate
    index = np.floor(time / step + 1e-6).astype(np.int64)
    after = time - index * step
    return Samples(index, np.where(after < 1e-6 * step, 0.0, after))


def at_samples(values: Array, samples: Samples, step: float) -> Array:
    """Return values, shape (M,) one per step [s] of the integrator, at the samples, shape (N,); straight between steps."""
    after = np.minimum(samples.step + 1, values.size - 1)
    return np.asarray(values[samples.step] + samples.after / step * (values[after] - values[samples.step]))


class Trip(NamedTuple):
    """What is driven: the course under the control with its targets, in steps [s] of the integrator, and what is recorded."""

    targets: Targets
    course: Course
    samples: Samples
    step: float


def drive(
    stages: Sequence[tuple[int, Plant]],
    trip: Trip,
    x: Array,
    progress: Callable[[float], None] | None = None,
    with_trail: bool = False,
) -> tuple[Array, Array]:
    """Return what was recorded, and move the state x, shape (9,), to the end of the course.

    The result is `RECORDED` at the N samples, shape (N, len(RECORDED)), and, with a trail, `TRAIL` at every step [s], shape
    (steps + 1, len(TRAIL)), otherwise no row of it. `stages` are the plant from each of some actions of the control on, rising
    from 0. Between two steps a sample is reached by a shorter step aside, so that recording never disturbs the course.
    """
    targets, course, samples, step = trip
    substeps = round(targets.period / step)
    commands = np.array([0.0, x[U_VGT], 0.0, x[U_VGT]])
    recorded = np.empty((samples.step.size, len(RECORDED)))
    actions = course.n_e.size - 1
    trail = np.empty((actions * substeps + 1 if with_trail else 0, len(TRAIL)))
    done = 0
    plants, plant = dict(stages), stages[0][1]
    for first, last in pairwise(sorted({*plants, *range(0, actions, CHUNK), actions})):
        plant = plants.get(first, plant)
        done = _run(plant, trip, first, last, x, commands, done, recorded, trail)
        if progress is not None:
            progress(last / actions)
    end = inputs_at(Interval(course, Commands(*commands), targets.period, actions - 1), targets.period)
    for row in (*recorded[done:], *trail[-1:]):  # the last sample may lie on the end of the course
        record(plant, end, x, row)
    return recorded, trail


@njit(cache=True)
def _run(
    plant: Plant, trip: Trip, first: int, last: int, x: Array, memory: Array, done: int, recorded: Array, trail: Array
) -> int:
    """Run the actions first..last and record the samples on the way; return the number of samples done."""
    # The last commands stay in `memory`, shape (4,). They are not returned as `Commands`: numba makes that in Python, where
    # a signal that arrived meanwhile is raised, and numba does not expect it there.
    targets, course, samples, step = trip
    commands, substeps = Commands(memory[0], memory[1], memory[2], memory[3]), round(targets.period / step)
    work = np.empty((6, x.size))
    for action in range(first, last):
        given = inputs_at(Interval(course, commands, targets.period, action), 0.0)
        W_c = flows(plant, x, given).W_c
        commands = control(targets, commands, given, x, W_c)
        now = Interval(course, commands, targets.period, action)
        for part in range(substeps):
            start = part * step
            while done < samples.step.size and samples.step[done] == action * substeps + part:
                after = samples.after[done]
                work[5] = x
                if after > 0.0:
                    runge_kutta(plant, now, start, after, work[5], work)
                record(plant, inputs_at(now, start + after), work[5], recorded[done])
                done += 1
            if trail.shape[0] > 0:
                record(plant, inputs_at(now, start), x, trail[action * substeps + part])
            runge_kutta(plant, now, start, step, x, work)
    for index in range(4):
        memory[index] = commands[index]
    return done


@njit(cache=True)
def inputs_at(now: Interval, after: float) -> Inputs:
    """Return the plant's inputs some time [s] after an action of the control."""
    course, commands, period, action = now
    share = after / period
    n_e = (1.0 - share) * course.n_e[action] + share * course.n_e[action + 1]
    u_demand = (1.0 - share) * course.u_demand[action] + share * course.u_demand[action + 1]
    # written so that what is constant stays so to the last bit
    p_amb = course.p_amb[action] + share * (course.p_amb[action + 1] - course.p_amb[action])
    T_amb = course.T_amb[action] + share * (course.T_amb[action + 1] - course.T_amb[action])
    T_wall, v_air = course.T_wall[action], course.v_air[action]  # too slow to need more
    return Inputs(n_e, u_demand, commands.u_egr, commands.u_vgt, p_amb, T_amb, T_wall, v_air)


@njit(cache=True)
def runge_kutta(plant: Plant, now: Interval, start: float, step: float, x: Array, work: Array) -> None:
    """Move the state x on by one step [s] that begins `start` seconds after an action; `work` holds the slopes."""
    middle = inputs_at(now, start + 0.5 * step)
    derivative(plant, x, inputs_at(now, start), work[0])
    _shift(x, 0.5 * step, work[0], work[4])
    derivative(plant, work[4], middle, work[1])
    _shift(x, 0.5 * step, work[1], work[4])
    derivative(plant, work[4], middle, work[2])
    _shift(x, step, work[2], work[4])
    derivative(plant, work[4], inputs_at(now, start + step), work[3])
    for i in range(x.size):
        x[i] += step / 6.0 * (work[0, i] + 2.0 * work[1, i] + 2.0 * work[2, i] + work[3, i])
    x[OMEGA_T] = max(x[OMEGA_T], relation.SLOWEST_TURBINE)


@njit(cache=True)
def _shift(x: Array, by: float, slope: Array, out: Array) -> None:
    for i in range(x.size):
        out[i] = x[i] + by * slope[i]


@njit(cache=True)
def record(plant: Plant, given: Inputs, x: Array, out: Array) -> None:
    """Write what `RECORDED` names at one instant into `out`, or what `TRAIL` names into a shorter one."""
    f = flows(plant, x, given)
    out[0], out[1], out[2], out[3] = given.n_e, f.u_delta, f.W_c, x[T_IM]
    if out.size > len(TRAIL):
        out[4], out[5], out[6], out[7], out[8] = f.u_egr, x[U_VGT], x[P_IM], x[P_EM], x[OMEGA_T]
        out[9], out[10], out[11], out[12], out[13] = f.T_em, f.W_egr, f.W_ei, f.W_leak, f.charge_warming
