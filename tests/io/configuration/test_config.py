"""The configuration: what is refused, where, and that the shipped files are complete."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass

import numpy as np
import pytest
from repository import CONFIGS, DIESEL

from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import Axis, load_config, load_effects

TEXT = DIESEL.read_text(encoding="utf-8")


def refusal(path, *words, load=load_config):
    with pytest.raises(UsageError) as failure:
        load(path)
    text = str(failure.value)
    assert "\n" not in text
    for word in (str(path), *words):
        assert word in text, (word, text)


@pytest.fixture
def changed(tmp_path):
    """Return a function that writes the shipped configuration with one passage exchanged."""

    def write(old, new):
        assert TEXT.count(old) == 1, f"the test needs '{old}' once in {DIESEL.name}"
        path = tmp_path / "changed.toml"
        path.write_text(TEXT.replace(old, new), encoding="utf-8")
        return path

    return write


def test_the_shipped_configuration_is_complete():
    config, text = load_config(DIESEL)
    assert text == TEXT
    assert config.air_path == "diesel"
    grid = config.grid()
    np.testing.assert_array_equal(grid.fuel, np.arange(0.0, 57.0, 4.0))
    np.testing.assert_array_equal(grid.speed, np.arange(0.0, 4001.0, 250.0))
    assert config.published.gamma == 200.0
    assert (config.policies.gap_limit, config.policies.backward_time) == (1.0, "refuse")


def test_every_constant_arrives(engine):
    """The conftest reads the same tables without the reader under test."""
    assert load_config(DIESEL)[0].engine == engine


def test_tolerances_name_constants_that_exist():
    config, _ = load_config(DIESEL)
    assert set(config.estimate.tolerance) <= set(config.engine_path().engine_constants())


def test_gain_speaks_of_parameters_and_states_that_exist():
    config, _ = load_config(DIESEL)
    path = config.engine_path()
    assert set(config.gain.bounds) <= set(path.parameter_names)
    assert set(config.gain.outputs) <= set(path.state_names)
    assert set(config.gain.temperatures) <= set(path.channels)


def as_toml(record, where=""):
    """Return a record as TOML text: plain values first, then one table per record or mapping."""
    items = {item.name: getattr(record, item.name) for item in fields(record)} if is_dataclass(record) else dict(record)
    items = {key: value for key, value in items.items() if value is not None}
    tables = {key: value for key, value in items.items() if is_dataclass(value) or isinstance(value, Mapping)}
    lines = [f"{key} = {_value(value)}" for key, value in items.items() if key not in tables]
    head = [f"[{where}]"] if where else []
    return "\n".join(
        head + lines + [as_toml(table, f"{where}.{key}" if where else key) for key, table in tables.items()]
    )


def _value(value):
    if is_dataclass(value):  # a record in a list
        return "{" + ", ".join(f"{item.name} = {_value(getattr(value, item.name))}" for item in fields(value)) + "}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value)  # numbers, strings and truth values are spelled alike


def test_round_trip(tmp_path):
    config, _ = load_config(DIESEL)
    path = tmp_path / "again.toml"
    path.write_text(as_toml(config), encoding="utf-8")
    assert load_config(path)[0] == config


def test_nothing_in_the_file_is_lost():
    """Every key of the file is a field of the record, with the same value."""

    def compare(table, record, where):
        for key, value in table.items():
            found = record[key]
            if isinstance(value, dict):
                compare(value, found, f"{where}{key}.")
            else:
                assert _listed(found) == _listed(value), f"{where}{key}"

    config, _ = load_config(DIESEL)
    compare(tomllib.loads(TEXT), asdict(config), "")


def _listed(value):
    return [_listed(item) for item in value] if isinstance(value, tuple | list) else value


# --- keys --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("least_information = 0.1", "least_informations = 0.1", ("estimate.least_informations", "'least_information'")),
        ("gap_limit = 1.0", "gap_limt = 1.0", ("policies.gap_limt", "'gap_limit'")),
        ("\n[policies]", "\n[sensors.T_em]\ntua = 1.0\n[policies]", ("sensors.T_em.tua", "'tau'")),
        ("[gain.temperatures]", "[gain.temperature]", ("gain.temperature", "'temperatures'")),
        ("c_vol1 = -2.08e-4", "c_voll = -2.08e-4", ("engine.filling.c_voll", "'c_vol")),
        ('air_path = "diesel"', 'airpath = "diesel"', ("'airpath'", "'air_path'")),
        ("u_delta = { start = 0, stop", "u_delta = { begin = 0, stop", ("map.u_delta.begin",)),
        ("schema = 1", "schema = 1\nxyzzy = 2", ("'xyzzy'", "known here")),
    ],
)
def test_an_unknown_key_is_refused_with_the_nearest_one(changed, old, new, words):
    refusal(changed(old, new), "unknown key", *words)


@pytest.mark.parametrize(
    ("old", "place"),
    [
        ("gap_limit = 1.0 ", "policies.gap_limit"),
        ("gamma = 200.0 ", "published.gamma"),
        ("R_e = 286.0 ", "engine.gas.R_e"),
        ("smoothing = 0.05 ", "estimate.smoothing"),
        ("schema = 1\n", "schema"),
        ("map_drift = 1e-5 ", "ekf.map_drift"),
    ],
)
def test_a_missing_key_is_named_unless_it_has_a_default(changed, old, place):
    path = changed(old, "# " + old)
    if place == "policies.gap_limit":
        assert load_config(path)[0].policies.gap_limit == 1.0
    else:
        refusal(path, f"'{place}'", "missing")


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("smoothing = 0.05", 'smoothing = "50 ms"', "toml: estimate.smoothing"),
        ("R_a = 287.0", "R_a = true", "toml: engine.gas.R_a: expected a number, got true or false; correct this key"),
        ("Q = [32.0, -8.0, 2.15]", "Q = [32.0, -8.0]", "toml: engine.compressor.Q"),
        ("n_cyl = 4", "n_cyl = 4.5", "toml: engine.geometry.n_cyl"),
        ("x_0 = [9.8e4, 9.8e4, 0.0]", 'x_0 = "ambient"', "toml: published.x_0"),
        ("rho_5 = [0.0, 3.15]", "rho_5 = 3.15", "toml: gain.bounds.rho_5: expected"),
        ("R_c = 0.01", 'R_c = "1 %"', "toml: estimate.tolerance.R_c: expected a number, got a text; correct"),
        ("n_cyl = 4", "n_cyl = [4]", "toml: engine.geometry.n_cyl"),
        ("stop = 4000, step = 250", "stop = 4000, step = 333", "toml: map.n_e: step 333 does not divide"),
    ],
)
def test_a_wrong_type_is_refused_with_its_place(changed, old, new, place):
    refusal(changed(old, new), place)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("smoothing = 0.05", "smoothing = 0.0", ("smoothing", "above 0")),
        ("smoothing = 0.05", "smoothing = nan", ("smoothing", "above 0")),
        ("R_c = 0.01", "R_c = 0.7", ("tolerance",)),
        ("gamma = 200.0", "gamma = -1.0", ("gamma",)),
        ('backward_time = "refuse"', 'backward_time = "sort"', ("backward_time",)),
        ("margin = 0.05", "margin = 2.0", ("margin",)),
        ("rho_5 = [0.0, 3.15]", "rho_5 = [3.15, 0.0]", ("rho_5",)),
        ("n_e = { start = 0, stop = 4000", "n_e = { start = 4000, stop = 0", ("axis",)),
        ("stop = 56, step = 4 }", "stop = 56, step = 0 }", ("axis",)),
        ("stop = 56, step = 4 }", "stop = 56, step = 1e-9 }", ("axis",)),
        ("stop = 56, step = 4 }", "stop = inf, step = 4 }", ("axis",)),
        ("schema = 1", "schema = 2", ("schema",)),
        ('air_path = "diesel"', 'air_path = "steam"', ("'steam'", "'diesel'")),
        ('air_path = "diesel"', 'air_path.x = "diesel"', ("{'x': 'diesel'}", "'diesel'")),
        ("\nn_e = { start", "\nspeed = { start", ("speed", "n_e")),
        ("\n[policies]", "\n[sensors.T_em]\ntau = -1.0\n[policies]", ("sensors", "tau")),
        ("\n[policies]", "\n[sensors.T_em]\ndelay = 1000.0\n[policies]", ("sensors", "delay")),
    ],
)
def test_an_impossible_value_is_refused(changed, old, new, words):
    refusal(changed(old, new), *words)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("R_c = 0.01", "R_compressor = 0.01", "R_compressor"),
        ('outputs = ["p_im", "p_em", "omega_t"]', 'outputs = ["p_im", "boost"]', "boost"),
        ('outputs = ["p_im", "p_em", "omega_t"]', 'outputs = ["p_im", "p_im"]', "p_im"),
        ("rho_5 = [0.0, 3.15]", "rho_6 = [0.0, 3.15]", "rho_6"),
        ("\nT_em = [", "\nT_exhaust = [", "T_e"),
        ("nonnegative_sums = []", 'nonnegative_sums = [["rho_2", "rho_9"]]', "rho_9"),
        ("omega_t = 500.0", "omega = 500.0", "omega"),
        ("\n[policies]", "\n[sensors.T_exhaust]\ntau = 1.0\n[policies]", "sensors: the name 'T_exhaust'"),
        ("\n[policies]", "\n[sensors.T_im]\npulsation = 0.1\n[policies]", "no model of pulsation"),
    ],
)
def test_a_name_that_the_engine_does_not_have_is_refused(changed, old, new, word):
    """Tables with free keys take any name; the engine decides which exist."""
    refusal(changed(old, new), word)


@pytest.mark.parametrize("constant", ["V_im = 5.0e-3", "J_t = 1.6e-5"])
@pytest.mark.parametrize("value", ["0.0", "-1.0", "nan"])
def test_an_engine_that_cannot_be_built_is_refused(changed, constant, value):
    name = constant.split(" = ", maxsplit=1)[0]
    refusal(changed(constant, f"{name} = {value}"), name)


# --- files -------------------------------------------------------------------------------------------------------------


def test_files_that_are_no_configuration(tmp_path):
    refusal(tmp_path / "none.toml", "cannot be read")
    refusal(tmp_path, "cannot be read")
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xff\xfe\x00")
    refusal(path, "UTF-8")
    path.write_text("schema = = 1")
    refusal(path, "TOML")
    path.write_text("")
    refusal(path, "missing")


def test_axes_end_where_they_say():
    np.testing.assert_array_equal(Axis(0.0, 1.0, 0.1).nodes(), np.arange(11) / 10)
    np.testing.assert_array_equal(Axis(-4.0, 4.0, 8.0).nodes(), [-4.0, 4.0])
    nodes = Axis(800.0, 3900.0, 310.0).nodes()
    assert (nodes[0], nodes[-1], nodes.size) == (800.0, 3900.0, 11)


def test_a_step_that_does_not_divide_the_axis_is_refused(changed):
    """0 to 56 in steps of 5 has no last node; stretching the step in silence would move every node."""
    refusal(changed("stop = 56, step = 4 }", "stop = 56, step = 5 }"), "step")


# --- effects -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted((CONFIGS / "surfaces").glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_surfaces_can_be_read(path):
    effects = load_effects(path)
    assert effects.surface.kind == tomllib.loads(path.read_text(encoding="utf-8"))["surface"]["kind"]


def test_a_surface_is_read_as_strictly(tmp_path):
    path = tmp_path / "effects.toml"
    for text, word in (
        ("[surface]\nkind = 'cubic'", "kind"),
        ("[surface]\nkind = 'king'\nslop = 0.9", "'slope'"),
        ("[surface]\nkind = 'quadratic'\nbumps = [{amplitude = 1, hight = 2}]", "surface.bumps[0]"),
        ("[surfaces]\nkind = 'zero'", "'surface'"),
    ):
        path.write_text(text)
        refusal(path, word, load=load_effects)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected a table [surface], [[effect]] or [auxiliary]"),
        ("[[effect]]\ntau = 0.1", "key 'id' is missing"),
        ("[[effect]]\nid = 'maf.lagg'\ntau = 0.1", "did you mean 'maf.lag'?"),
        ("[[effect]]\nid = 'unloged'", "did you mean 'unlogged'?"),
        ("[[effect]]\nid = 'chanel:humidity'", "did you mean 'channel:NAME'?"),
        ("[[effect]]\nid = '??'", "unknown effect; expected one of maf.gain"),
        ("[[effect]]\nid = 'p_ic.gain'\nfactor = 1.1", "only the throttled engine has one"),
        ("[[effect]]\nid = 'alpha_th.offset'\noffset = 1", "the simulated diesel has no alpha_th"),
        ("[[effect]]\nid = 'maf.lag'", "parameter 'tau' is missing"),
        (
            "[[effect]]\nid = 'maf.lag'\ntau = 0.1\nfactor = 2",
            "unknown key 'factor'; expected id, tau, course, onset, end",
        ),
        ("[[effect]]\nid = 'maf.lag'\ntau = '80 ms'", "tau = '80 ms', expected a number"),
        ("[[effect]]\nid = 'maf.lag'\ntau = true", "expected a number"),
        ("[[effect]]\nid = 'maf.lag'\ntau = nan", "expected a number"),
        ("[[effect]]\nid = 'maf.lag'\ntau = 80", "tau = 80 s, expected 0 to 5; check its unit"),
        ("[[effect]]\nid = 'leak.intake'\narea = 20", "check its unit"),
        ("[[effect]]\nid = 'leak.intake'\narea = -1e-5", "expected 0 to"),
        ("[[effect]]\nid = 'maf.gain'\nfactor = inf", "expected 0.3 to 3"),
        ("[[effect]]\nid = 'maf.gain'\nfactor = 1.1\nonset = 9\nend = 9", "is not after onset = 9"),
        ("[[effect]]\nid = 'maf.gain'\nfactor = 1.1\nend = 0", "is not after onset = 0"),
        ("[[effect]]\nid = 'maf.gain'\nfactor = 1.1\nonset = -1", "expected seconds since the start"),
        ("[[effect]]\nid = 'maf.gain'\nfactor = 1.1\nonset = inf", "expected seconds since the start"),
        ("[effect]\nid = 'maf.gain'\nfactor = 1.1", "under its own [[effect]]"),
        ("effect = [1]", "under its own [[effect]]"),
        ("[[efect]]\nid = 'maf.gain'\nfactor = 1.1", "'efect'"),
        ("[auxilary]", "did you mean 'auxiliary'?"),
        ("[auxiliary]\nchannel = []", "did you mean 'channels'?"),
        ("[auxiliary]\nchannels = ['T_oil']", "'T_oil' is not an auxiliary channel"),
        ("[[effect]]\nid = 'channel:T_oil'\nform = 'gain'\namplitude = 1", "no such auxiliary channel"),
        ("[[effect]]\nid = 'channel:humidity'\namplitude = 1", "key 'form' is missing"),
        ("[[effect]]\nid = 'channel:humidity'\nform = 'gain'", "parameter 'amplitude' is missing"),
        ("[[effect]]\nid = 'channel:humidity'\nform = 'gain'\namplitude = 1\nrate = 2", "unknown key 'rate'"),
        ("[[effect]]\nid = 'unlogged'\nform = 'gain'\namplitude = 0.1", "either episodes"),
        (
            "[[effect]]\nid = 'unlogged'\nform = 'gain'\namplitude = 0.1\nepisodes = [[1, 2], [3, 4]]\n"
            "telegraph = { seed = 1, on = 9.0, off = 9.0 }",
            "either episodes",
        ),
        (
            "[[effect]]\nid = 'unlogged'\nform = 'gain'\namplitude = 0.1\nepisodes = [[1, 2, 3]]",
            "not a list of pairs of seconds",
        ),
        ("[[effect]]\nid = 'unlogged'\nform = 'gain'\namplitude = 0.1\nepisodes = 5", "not a list of pairs of seconds"),
        (
            "[[effect]]\nid = 'unlogged'\nform = 'gain'\namplitude = 0.1\ntelegraph = { seed = true, on = 9, off = 9 }",
            "a whole number as seed",
        ),
        (
            "[[effect]]\nid = 'unlogged'\nform = 'gain'\namplitude = 0.1\ntelegraph = { seed = 1, on = 9, of = 9 }",
            "unknown key 'of'",
        ),
        (
            "[[effect]]\nid = 'unlogged'\nform = 'gain'\namplitude = 0.1\nonset = 3\nepisodes = []",
            "unknown key 'onset'",
        ),
    ],
)
def test_an_effect_that_cannot_be_meant_is_refused_with_its_place(tmp_path, text, words):
    path = tmp_path / "effects.toml"
    path.write_text(text)
    refusal(path, words, load=load_effects)


def test_the_second_of_two_effects_is_named_by_its_place(tmp_path):
    path = tmp_path / "effects.toml"
    path.write_text("[[effect]]\nid = 'maf.gain'\nfactor = 1.1\n[[effect]]\nid = 'maf.lag'\ntau = -1")
    refusal(path, "effect[1]: maf.lag: tau = -1", load=load_effects)


def test_effects_keep_parameters_and_times(tmp_path):
    path = tmp_path / "effects.toml"
    path.write_text(
        "[[effect]]\nid = 'maf.delay'\ndelay = 1\nonset = 3\nend = 4.5\n[auxiliary]\nchannels = ['humidity']"
    )
    effects = load_effects(path)
    (delay,) = effects.injected
    assert (delay.id, delay.value, delay.onset, delay.end) == ("maf.delay", 1.0, 3.0, 4.5)
    assert effects.auxiliary.channels == ("humidity",)
    assert effects.surface is None
