"""`verify`: the proof of a stored gain again, without the solver."""

from dataclasses import dataclass, replace
from functools import partial

from lpvobs.api.files import File, as_path
from lpvobs.engines.base import AirPath
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import DataError, NotProven
from lpvobs.io.results.gains import StoredGain, expect_engine, read_gain
from lpvobs.report.outputs import StateBoundOutput
from lpvobs.synthesis.certificate import Certificate, check, prove_bound
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region


@dataclass(frozen=True, kw_only=True)
class VerifyOutput(Certificate):
    """A certificate proven again, or not, and which engine and temperatures its region belongs to."""

    gain: str
    region: str
    made_for: str
    state_bound: StateBoundOutput | None


def verify(gain: File, config: File | None = None) -> Certificate:
    """Prove a stored gain again in rational arithmetic, without the solver, and return the certificate.

    Raises NotProven if the stored numbers do not prove Theorem 1 on the stored region; DataError if the file cannot be used, or
    is for another engine.

    Parameters
    ----------
    config : path, optional
        The engine that it has to be for.
    """
    return expect_proven(gain, check_stored(gain, config)[1])


def check_stored(gain: File, config: File | None = None) -> tuple[StoredGain, Certificate]:
    """Return a stored gain and what came of the proof, which may be that nothing is proven; raises DataError as `verify`."""
    stored = read_gain(as_path(gain))
    if config is not None:
        from lpvobs.io.configuration.config import load_config

        expect_engine(as_path(gain), stored, load_config(as_path(config))[0])
    return stored, check_again(stored)


def expect_proven(gain: File, certificate: Certificate) -> Certificate:
    """Return a certificate; raises NotProven where it does not hold."""
    if not certificate.proven:
        raise NotProven(
            f"{gain}: stability is not proven for this gain: {certificate.reason}; make the gain again with `lpvobs synth-gain`"
        )
    return certificate


def problem_of(air_path: AirPath | type[AirPath], outputs: tuple[str, ...], region: Region) -> GainProblem:
    """Return the data of Theorem 1 for an engine."""
    return GainProblem(partial(air_path.system, outputs=outputs), region, len(outputs))


def check_again(stored: StoredGain) -> Certificate:
    """Prove a stored gain again, from its numbers alone; raises DataError for another engine, or numbers that do not fit."""
    if stored.air_path not in ENGINES:
        raise DataError(f"gain: made for an unknown air path '{stored.air_path}'; expected one of {', '.join(ENGINES)}")
    gain, known = stored.gain, ENGINES[stored.air_path].air_path
    if gain.region.names != known.parameter_names or not set(stored.outputs) <= set(known.state_names):
        raise DataError(
            f"gain: its parameters {', '.join(gain.region.names)} and outputs {', '.join(stored.outputs)} do not fit an engine of "
            f"kind {stored.air_path}; make the gain again with `lpvobs synth-gain`"
        )
    problem = problem_of(known, stored.outputs, gain.region)
    found = check(problem, gain.L, gain.P, gain.Q, gain.eps_1, gain.eps_2)
    reason = "" if gain.bound is None else prove_bound(problem, gain.L, gain.bound)
    return replace(found, proven=False, reason=reason) if found.proven and reason else found
