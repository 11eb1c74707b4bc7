"""The observer in C against Python on all cycles, and what a step costs beside Kalman filters: `make unit`.

Needs gcc and valgrind; clang, cppcheck, gcc-arm-none-eabi and qemu-system-arm where they are there. Logs of the cycles are taken
from the folder named (build/logs by default) and drawn where they lack.
"""

import csv
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1] / "tests")]

from common import CONFIG, configuration, markdown, publish  # noqa: E402
from reference import control_unit as twin  # noqa: E402

from lpvobs import estimate, simulate, synth_gain  # noqa: E402
from lpvobs.api.export_unit import export_unit, unit_of  # noqa: E402
from lpvobs.io.control_unit.sources import sources  # noqa: E402
from lpvobs.io.logs.reading import read_log  # noqa: E402
from lpvobs.io.results.gains import read_gain  # noqa: E402
from lpvobs.maps.grid import Grid  # noqa: E402
from lpvobs.maps.metrics import compare  # noqa: E402
from lpvobs.observer import ekf  # noqa: E402
from lpvobs.observer.parts import operating_point  # noqa: E402

CYCLES = ("etc_part1", "etc", "ftp75_cold", "ftp75", "nedc", "wltc", "whtc")
MODES = ("constant", "falling", "corrected")
TAUGHT_BY = "nedc"
"""The drive whose `estimate` gives the engine of the third mode: constants, and corrections as tables. Its map is not taken."""
PAPER = Grid(np.arange(0.0, 57.0, 4.0), np.arange(0.0, 3001.0, 250.0))
"""The 15 x 13 = 195 nodes of Sec. 4.1."""
BASIS = ("-std=c99", "-O2", "-ffp-contract=off")
STRICT = ("-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")
CHECKED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
M7 = ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "--specs=rdimon.specs", "-nostartfiles")
QEMU = (
    "qemu-system-arm -M mps2-an500 -nographic -monitor none -serial none -semihosting-config enable=on,target=native "
    "-icount shift=0"
)
SMOOTHS = "    smooth(s, k, u);\n"
AS_READ = "    for (i = 0U; i < LPVOBS_CHANNELS; i++) {\n        u[i] = s->channel[index_of(s, k)][i];\n    }\n"
"""The filters take signals as read; for the same cost the observer is counted without its window as well."""
SAMPLES = 2000
FIRST = 3000
"""Samples of the FTP75 cold transient that the cost is counted on: the vehicle is on its way, and cells change."""

EQUAL = (
    "cycle",
    "map gain",
    "samples",
    "state, double",
    "map, double",
    "state, float",
    "map, float",
    "error of the map",
)
ABOUT_EQUAL = f"""Largest differences: of any state relative, of any node over the largest node. Double is compiled with
-ffp-contract=off; what is left is the order of sums in the plain twin of the falling gain. The error of the map is the mean
relative one against the truth: one balance and the configured engine, as in the published method, but smoothed signals.
Corrected: a falling gain, the engine that `estimate` finds on {TAUGHT_BY}, its corrections as tables; the map starts at zero.
The engine that is simulated is the configured one, so whatever is found from a drive is further from it."""
COST = ("method", *2 * ("bytes", "instructions", "Cortex-M7", "Cortex-M7, worst"))
ABOUT_COST = f"""The first four in double, then in single precision. Bytes of the state; instructions of a step, mean of {SAMPLES}
(callgrind on this machine, -O2), and on a Cortex-M7 with a unit for double precision (QEMU: instructions, not cycles). Powers
come from each machine's libm. At a gap all samples that wait are worked on in one step: six at 100 Hz and 0.05 s."""


def run(*call, folder=None):
    done = subprocess.run([*map(str, call)], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, call))}: {done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def unit_as(mode, gain, result):
    """Return the unit of a mode, its map at zero."""
    unit = unit_of(gain, read_gain(gain), result if mode == "corrected" else None, mode != "constant", 100.0)
    return replace(unit, theta=np.zeros(unit.grid.size), driven=np.zeros(unit.grid.size))


def equality(logs, gain, result, folder):
    """Return a row a cycle: differences of C and Python, and what the map is worth."""
    rows = []
    for cycle in CYCLES:
        path = logs / f"{cycle}.parquet"
        table = pq.read_table(path)
        listing = folder / "log.csv"
        table.to_pandas().to_csv(listing, index=False)
        for mode in MODES:
            unit = unit_as(mode, gain, result)
            log = read_log(path, unit.channels, configuration().policies)
            x, theta = (twin.falling if unit.falling else twin.constant)(unit, log)
            row = [cycle, mode, str(len(log))]
            for number in ("double", "float"):
                program = folder / f"bench-{row[1]}-{number}"
                run(program, listing, folder / "map.csv", folder / "states.csv")
                seen = np.loadtxt(folder / "states.csv", delimiter=",")
                surface = np.loadtxt(folder / "map.csv", delimiter=",", skiprows=1)[:, 2]
                at = np.searchsorted(log.time, seen[:, 0])
                state = np.abs(seen[:, 1 : 1 + x.shape[1]] / x[at] - 1.0).max()
                row += [f"{state:.1e}", f"{np.abs(surface - theta).max() / np.abs(theta).max():.1e}"]
                if number == "double":
                    reference = table["ref_delta_W_c"].to_numpy()[log.rows]
                    worth = compare(
                        unit.grid, surface.reshape(unit.grid.shape), *operating_point(unit.air_path, log), reference
                    )
            rows.append([*row, f"{100 * worth.mean_relative_error:.2f} %"])
            print(*rows[-1], flush=True)
    return rows


def written(unit, place):
    """Write the sources of a unit into a new folder, and return it."""
    place.mkdir()
    for name, text in sources(unit).items():
        (place / name).write_text(text, encoding="utf-8")
    return place


def built(gain, result, folder):
    """Compile the bench in every variant, strictly; return what was clean."""
    said = []
    for mode in MODES:
        place = written(unit_as(mode, gain, result), folder / mode)
        files = sorted(place.glob("*.c"))
        for number, flag in (("double", []), ("float", ["-DLPVOBS_FLOAT"])):
            for compiler in filter(shutil.which, ("gcc", "clang")):
                run(compiler, *BASIS, *STRICT, *flag, *files, "-lm", "-o", folder / f"bench-{mode}-{number}-{compiler}")
                checked = folder / f"checked-{mode}-{number}-{compiler}"
                run(compiler, *BASIS, *STRICT, *CHECKED, *flag, *files, "-lm", "-o", checked)
                said.append(f"{compiler}, {mode}, {number}")
            shutil.copy(folder / f"bench-{mode}-{number}-gcc", folder / f"bench-{mode}-{number}")
    return said


def sanitized(logs, folder):
    """Run every cycle through the programs with sanitizers; a finding ends this program."""
    for cycle in CYCLES:
        pq.read_table(logs / f"{cycle}.parquet").to_pandas().to_csv(folder / "log.csv", index=False)
        for program in sorted(folder.glob("checked-*")):
            run(program, folder / "log.csv", folder / "map.csv")


def misra(folder):
    """Return the rules of MISRA C:2012 that cppcheck's addon finds broken, with how often, in each number format."""
    if shutil.which("cppcheck") is None:
        return "cppcheck is not here"
    found = {}
    for flag in ("-UX", "-DLPVOBS_FLOAT"):
        call = ["cppcheck", "--addon=misra", "--enable=style", "--std=c99", flag, "-I", folder]
        text = run(*call, *(folder / f"lpvobs{part}.c" for part in ("", "_model", "_tables")))
        for rule in re.findall(r"misra-c2012-([\d.]+)", text):
            found[rule] = found.get(rule, 0) + 1
    return ", ".join(f"{rule} ({count})" for rule, count in sorted(found.items())) or "none"


def cost(gain, result, logs, folder):
    """Return a row a method: bytes, instructions of a step on this machine and on a Cortex-M7."""
    config, none = configuration(), np.zeros(PAPER.size)
    units = [
        replace(unit_as(mode, gain, result), grid=PAPER, theta=none, driven=none) for mode in ("falling", "corrected")
    ]
    plain, corrected = (written(unit, folder / f"paper-{bool(unit.corrections)}") for unit in units)
    unit = units[0]
    log = read_log(logs / "ftp75_cold.parquet", unit.channels, config.policies)
    columns = np.column_stack([log.time, *log.channels.values()])[FIRST : FIRST + SAMPLES]
    with (folder / "log.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([list(map(repr, row)) for row in columns.tolist()])
    noise = [config.ekf.measurement_noise[name] for name in (*unit.stored.outputs, unit.air_path.sensor)]
    drift = [config.ekf.process_noise[name] for name in unit.air_path.state_names]
    tuning = [f"-DEKF_PRIOR={config.ekf.prior_map}", f"-DEKF_DRIFT={config.ekf.map_drift}"]
    tuning += [f"-DEKF_{name}={{{','.join(map(str, v))}}}" for name, v in (("MEASUREMENT", noise), ("PROCESS", drift))]
    text = (plain / "lpvobs.c").read_text(encoding="utf-8")
    if SMOOTHS not in text:
        sys.exit("lpvobs.c: the call of smooth is written otherwise")
    (plain / "raw.c").write_text(text.replace(SMOOTHS, AS_READ), encoding="utf-8")
    methods = {
        "engine model alone (in each of the following)": (["-DMODEL"], []),
        "local observer, signals as read": (["-DRAW"], []),
        "local observer, with smoothing": ([], []),
        "local observer, with smoothing and corrections": ([], []),
        "Kalman filter, 3 + 4 states": (["-DEKF", "-DLOCAL"], [HERE / "ekf.c"]),
        "Kalman filter, 3 + 195 states": (["-DEKF"], [HERE / "ekf.c"]),
    }
    rows = []
    for name, (flags, more) in methods.items():
        row, place = [name], corrected if name.endswith("corrections") else plain
        own = [place / f"lpvobs{part}.c" for part in ("", "_model", "_tables")]
        for number in ([], ["-DLPVOBS_FLOAT"]):
            common = [*BASIS, *flags, *number, *tuning, f"-DSAMPLES={SAMPLES}", "-I", place, "-I", HERE]
            observer = place / "raw.c" if "-DRAW" in flags else own[0]
            common += [observer, *own[1:], *more, HERE / "cost.c"]
            run("gcc", *common, "-lm", "-o", folder / "cost")
            call = ("valgrind", "--tool=callgrind", "--callgrind-out-file=calls", "--toggle-collect=one_step", "./cost")
            said = run(*call, folder=folder)
            counted = int(re.findall(r"Collected : (\d+)", said)[0]) / SAMPLES
            state = re.findall(rf"^{SAMPLES} \S+ \S+ (\d+)$", said, re.M)[0]
            row += ["-" if "-DMODEL" in flags else state, f"{counted:.0f}"]
            if name.endswith("195 states") and not number:
                _agrees_with_python(config, unit, log, folder)
            row += _on_m7(common, folder)
        rows.append(row)
        print(*row, flush=True)
    return rows


def _agrees_with_python(config, unit, log, folder):
    """Hold the large filter against the package's, which the table compares the observer with."""
    part = slice(FIRST, FIRST + SAMPLES)
    log = replace(
        log, time=log.time[part], channels={n: c[part] for n, c in log.channels.items()}, segments=((0, SAMPLES),)
    )
    trajectory = unit.air_path.trajectory(log, unit.stored.outputs)
    R = np.array([config.ekf.measurement_noise[name] for name in (*unit.stored.outputs, unit.air_path.sensor)]) ** 2
    Q = np.array([config.ekf.process_noise[name] for name in unit.air_path.state_names]) ** 2
    begin = ekf.start(PAPER, config.ekf, len(Q))
    point, first = operating_point(unit.air_path, log), unit.air_path.states(log)[:1]
    found = ekf.adapt(begin, trajectory, log.time, log.segments, point, PAPER, R, Q, config.ekf.map_drift, first)
    np.testing.assert_allclose(np.loadtxt(folder / "map.csv"), found.theta, rtol=0, atol=1e-9)


def _on_m7(common, folder):
    if not (shutil.which("arm-none-eabi-gcc") and shutil.which("qemu-system-arm")):
        return ["-", "-"]
    run("arm-none-eabi-gcc", *M7, *common, HERE / "start_m7.c", "-T", HERE / "m7.ld", "-lm", "-o", folder / "cost.elf")
    _, mean, worst, _ = run(*QEMU.split(), "-kernel", "cost.elf", folder=folder).split()
    return [f"{float(mean):.0f}", f"{float(worst):.0f}"]


def main():
    logs = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parents[1] / "build" / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    for cycle in CYCLES:
        if not (logs / f"{cycle}.parquet").exists():
            simulate(CONFIG, cycle, out=logs / f"{cycle}.parquet", seed=1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        gain = folder / "gain.h5"
        synth_gain(CONFIG, [logs / f"{cycle}.parquet" for cycle in ("etc", "ftp75", "nedc")], out=gain)
        result = folder / "taught.h5"
        estimate(CONFIG, [logs / f"{TAUGHT_BY}.parquet"], out=result, gain=gain)
        compilers = built(gain, result, folder)
        proof = export_unit(gain, folder / "again", "c99")
        rules = misra(folder / "corrected")
        costs = cost(gain, result, logs, folder)
        equal = equality(logs, gain, result, folder)
        sanitized(logs, folder)
    clean = f"""Without a warning under {" ".join(STRICT)}: {"; ".join(compilers)}. All cycles without a finding of the sanitizers
({CHECKED[1]}) in each of them. MISRA C:2012 by cppcheck's addon, rules with findings: {rules}."""
    pivots = [(name, f"{pivot:.9f}") for name, pivot in proof.smallest_pivot.items()]
    text = [
        "## C beside Python, every cycle at 100 Hz",
        markdown(EQUAL, equal),
        ABOUT_EQUAL,
        "## The certificate in the numbers of the target",
        markdown(("gain rounded to", "smallest relative pivot"), pivots),
        "Theorem 1 in rational arithmetic at every vertex, for L as the target holds it.",
        "## What a step costs, 15 x 13 nodes",
        markdown(COST, costs),
        ABOUT_COST,
        "## Clean",
        clean,
    ]
    publish("control_unit", "The observer in a control unit", "\n\n".join(text), "make unit")


main()
