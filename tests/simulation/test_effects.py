"""Injected effects: the relations that physics promises, written here on their own."""

import hashlib

import numpy as np
import pytest

from lpvobs.simulation.effects import CATALOGUE, CatalogueEffect

SIZES = {
    "maf.gain": 1.06, "maf.offset": 1e-3, "maf.lag": 0.08, "maf.delay": 0.04, "maf.drift": 1e-3, "maf.temperature": 5e-3,
    "maf.contamination": 0.08, "maf.backflow": 0.3, "leak.intake": 2e-5, "leak.inlet": 5e-5, "egr.leak": 6e-6,
    "egr.area": 0.7, "eta_vol.factor": 0.94, "compressor.flow": 0.95, "turbine.efficiency": 0.9,
    "exhaust.restriction": 4.0, "u_delta.gain": 1.05, "p_im.gain": 1.02, "p_im.offset": 2e3, "p_em.gain": 1.02,
    "omega_t.gain": 1.005, "T_im.lag": 4.0, "eta_vol.curve": 0.03, "compressor.curve": -0.04, "egr.curve": -0.25,
    "turbine.curve": -0.06,
}  # fmt: skip
PLANT = [name for name, kind in CATALOGUE.items() if kind.place == "plant"]
QUANTA = {
    "n_e": 0.25,
    "u_delta": 0.01,
    "p_im": 10.0,
    "p_em": 10.0,
    "omega_t": 1.0,
    "T_im": 0.1,
    "T_em": 0.1,
    "W_maf": 1e-5,
}


def same(first, second, where=slice(None)):
    assert list(first.channels) == list(second.channels)
    return all(np.array_equal(first.channels[name][where], second.channels[name][where]) for name in first.channels)


# --- nothing injected, nothing changed -----------------------------------------------------------------------------------


def test_a_drive_without_effects_is_the_one_of_before(clean):
    """Digest of the quantised readings as recorded before effects existed.

    Whole numbers of the smallest step: a last bit that another machine's exp or pow computes differently does not reach them.
    """
    digest = hashlib.sha256()
    for name, quantum in QUANTA.items():
        digest.update(np.round(clean.channels[name] / quantum).astype(np.int64).tobytes())
    assert digest.hexdigest() == "ba57b93123259c503b692dabb5731920ad5020c2d9059874bf0ffdc6633dc796"


@pytest.mark.parametrize("identifier", CATALOGUE)
@pytest.mark.slow
def test_an_effect_of_no_size_changes_no_byte(inject, clean, identifier):
    assert same(inject(CatalogueEffect(identifier, CATALOGUE[identifier].neutral)), clean)


def test_the_plant_itself_is_neutral_at_neutral_values(config, clean):
    """Not because such effects are left out: the relations give the same bits when a condition says that nothing happened."""
    from lpvobs.simulation.plant import plant_of
    from lpvobs.simulation.simulate import stages_of

    plant = plant_of(config.engine, config.simulation)
    nothing = [CatalogueEffect(name, CATALOGUE[name].neutral) for name in PLANT]
    assert stages_of(plant, nothing, 0.01 * np.arange(100)) == ((0, plant),)


@pytest.mark.parametrize("identifier", ["maf.lag", "maf.delay", "T_im.lag"])
def test_off_the_integrators_beat_a_memory_leaves_the_rest_alone(inject, identifier):
    """30 Hz does not divide 1000: what has no memory must not be taken from between two steps because something else has one."""
    plain, log = inject(rate=30), inject(CatalogueEffect(identifier, SIZES[identifier], onset=4.0, end=13.0), rate=30)
    time, own = log.channels["time"], "T_im" if identifier == "T_im.lag" else "W_maf"
    outside = (time < 4.0 - 1e-9) | (time >= 13.0 - 1e-9)
    for name, values in log.channels.items():
        where = outside if name == own else slice(None)
        assert np.array_equal(values[where], plain.channels[name][where]), name


@pytest.mark.parametrize("identifier", [name for name in CATALOGUE if name != "maf.temperature"])
def test_an_effect_acts_between_onset_and_end_only(inject, clean, identifier):
    log = inject(CatalogueEffect(identifier, SIZES[identifier], onset=4.0, end=13.0))
    time = log.channels["time"]
    before, during = time < 4.0 - 1e-9, (time >= 4.0) & (time < 13.0)
    assert same(log, clean, before)
    assert not same(log, clean, during)
    if identifier not in PLANT:
        assert same(log, clean, time >= 13.0 - 1e-9)
