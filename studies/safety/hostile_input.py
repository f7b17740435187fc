"""Time and memory of the worst known input of each hostile class (docs/measurements/safety.md).

    python -m studies.safety.hostile_input [SOAK.json …]

Each file is given to its command in a process of its own; time is that of the processor, with the command's own
processes, memory the largest resident size of one of them. What `make soak` printed, saved to files, adds the number of
damaged files that were tried.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import h5py  # noqa: E402  # after the paths
import lz4.frame  # noqa: E402
import numpy as np  # noqa: E402
import scipy.io  # noqa: E402
from backports import zstd  # noqa: E402
from fuzzing.judged_run import Outcome, load_all_modules, run_command  # noqa: E402
from fuzzing.seed_files import ROBOT, URDF, make_seeds  # noqa: E402
from huge_files import mcap_of_one_chunk, write_hdf5  # noqa: E402

import dynid  # noqa: E402
from daq.recording.writer import RecordingWriter  # noqa: E402
from drivers.streams import ChannelLayout, StreamLayout  # noqa: E402

IMPORT = "--robot arm.yaml --by-order -o out.h5"
Make = Callable[[Path], None]


@dataclass(frozen=True)
class HostileClass:
    """A class of hostile input: what stands against it, its test, its cases, and the kinds that `make soak` damages."""

    name: str
    mechanism: str
    test: str
    cases: Sequence[tuple[str, str, Make]]
    kinds: tuple[str, ...] = ()


def text(content: str) -> Make:
    return lambda path: _write(path, content.encode())


def binary(content: Callable[[], bytes]) -> Make:
    return lambda path: _write(path, content())


def nothing(path: Path) -> None:
    """The command line says it all."""


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def link(target: str) -> Make:
    return lambda path: path.symlink_to(target)


def sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 10**12)


def looping_heap(path: Path) -> None:
    """HDF5 looks for a text of the events among zeros, for ever."""
    layout = StreamLayout("joints", (ChannelLayout("position", ("shoulder", "elbow")),), 100.0)
    with RecordingWriter(path, dynid.load_robot(path.with_name("arm.yaml")), (layout,)) as file:
        for number in range(10):
            file.event(1.0, "info", "x", f"message {number}")
    content = bytearray(path.read_bytes())
    first = content.index(b"info", content.rindex(b"GCOL"))
    content[first - 7] = 1 + (content.index(b"message 9") - first) // 256  # in the size of the text, which was 4
    path.write_bytes(content)


def waiting_block(path: Path) -> None:
    content = bytearray(path.with_name("run.h5").read_bytes())
    content[content.index(b"FHDB") + 30] ^= 1
    path.write_bytes(content)


def compressed_zeros(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name in ("t", "q", "torque"):
            file.create_dataset(name, data=np.zeros((2 * 10**6, 2)), chunks=(10**5, 2), compression="gzip")


def large_csv(path: Path) -> None:
    rows = "".join(f"{row / 500:.3f},{np.sin(row):.5f},0.2,1.5,{row % 7}\n" for row in range(100_000))
    path.write_text("t,q1,q2,torque1,torque2\n" + rows * (249_000_000 // len(rows)))


def aliases() -> str:
    letters = "abcdefghijklmnopqrst"
    lines = [f"{b}: &{b} [{', '.join([f'*{a}'] * 10)}]" for a, b in itertools.pairwise(letters)]
    return "\n".join(["a: &a [x, x, x, x, x, x, x, x, x, x]", *lines])


def many_links() -> str:
    links = (
        f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(80_000)
    )
    return f'<robot name="x">{"".join(links)}<link name="l80000"/></robot>'


def fifty_joints() -> str:
    rows = "".join(f"    - {{joint: j{k}, alpha: pi/2, d: 0.1, r: 0.1}}\n" for k in range(50))
    joints = "".join(
        f"  - {{name: j{k}, position: [-3, 3], velocity: 2, acceleration: 5, torque: 50}}\n" for k in range(50)
    )
    return f"name: many\nmodel:\n  mdh:\n{rows}joints:\n{joints}friction: {{model: coulomb-viscous, offset: true}}\n"


def samples_of(values: int) -> str:
    times = ",".join(f"{k / 100:.2f}" for k in range(values))
    return f"robot: two-links\nkind: samples\ntime: [{times}]\nposition: [{','.join(['[0,0]'] * values)}]\n"


NUMBERS = [
    *(f"identify run.h5 -o out {option}" for option in (
        "--delay 1e308", "--position-cutoff 1e-8", "--torque-cutoff 1e-8", "--decimate 1000000000", "--smoothing 1e308",
        "--rest-tolerance 1e308", "--reversals 1e308", "--start 1e308", "--split 1e308", "--split 1e-300",
        "--significance 1e-160", "--max-error 1e308", "--method energy --energy-window 1e-300",
    )),
    *(f"excite arm.yaml -o out.yaml {option}" for option in (
        "--period 1e-300", "--periods 1000000000", "--harmonics 100000", "--margin 1e308", "--ramp 1e-300",
    )),
    *(f"payload run.h5 val.h5 -o out {option}" for option in ("--mass 1e308", "--com 1e308,0,0", "--delay 1e308")),
    "info run.h5 --wanted-rsd 1e-160", "import run.csv --robot arm.yaml --rate 1e308 -o out.h5",
    "gains run.h5 val.h5 --mass 1e308 -o out", "record arm.yaml --duration 1e308 -o out.h5",
    "record arm.yaml --trajectory fourier.yaml --speed-scale 1e-300 --yes -o out.h5",
    "robot new --joints 1000000000 -o out.yaml", "demo --duration 1e308 -o out",
]  # fmt: skip

CLASSES = (
    HostileClass(
        "no regular file, or one of 1 TB",
        "`drivers/core/files.py`",
        "`tests/drivers/core/test_files.py`, `tests/daq/importers/test_bounds.py`",
        [
            ("x.h5", "info x.h5", sparse),
            ("x.yaml", "check x.yaml", link("/dev/zero")),
            ("x.csv", f"import x.csv {IMPORT}", link("/dev/zero")),
            ("x.mcap", f"import x.mcap {IMPORT}", sparse),
            ("x.json", "validate x.json run.h5", link("/dev/zero")),
            ("x.urdf", "check x.urdf", os.mkfifo),
            ("fourier.yaml", "record arm.yaml --trajectory fourier.yaml -o out.h5", link("/dev/zero")),
        ],
    ),
    HostileClass(
        "HDF5 over which the library loops, waits or crashes",
        "`drivers/core/reading_process.py`",
        "`tests/drivers/core/test_reading_process.py`, `tests/daq/recording/test_recover.py`",
        [
            ("x.h5", "info x.h5", looping_heap),
            ("x.h5", "identify x.h5 -o out", looping_heap),
            ("x.h5", "recover x.h5 -o out.h5", waiting_block),
        ],
        ("recording", "HDF5"),
    ),
    HostileClass(
        "HDF5 that leads out of its file, or declares more than it holds",
        "`daq/recording/hdf5_bounds.py`",
        "`tests/daq/importers/test_bounds.py`",
        [
            *(
                ("x.h5", f"import x.h5 {IMPORT}", lambda path, what=what: write_hdf5(path, what))
                for what in ("raw", "link", "virtual", "large", "sparse", "attribute", "texts")
            ),
            ("x.h5", f"import x.h5 {IMPORT}", compressed_zeros),
        ],
    ),
    HostileClass(
        "what unpacks to more than memory",
        "`drivers/core/reading_process.py`, sizes declared in npz and mat files before",
        "`tests/daq/importers/test_bounds.py`",
        [
            (
                "x.mcap",
                f"import x.mcap {IMPORT}",
                binary(lambda: mcap_of_one_chunk("zstd", zstd.compress(bytes(10**8)) * 100, 10**10)),
            ),
            (
                "x.mcap",
                f"import x.mcap {IMPORT}",
                binary(lambda: mcap_of_one_chunk("lz4", lz4.frame.compress(bytes(2 * 10**9)), 2 * 10**9)),
            ),
            ("x.npz", f"import x.npz {IMPORT}", lambda path: np.savez_compressed(path, q=np.zeros((10_000_000, 2)))),
            (
                "x.mat",
                f"import x.mat {IMPORT}",
                lambda path: scipy.io.savemat(path, {"q": np.zeros((10_000_000, 2))}, do_compression=True),
            ),
        ],
        ("npz", "mat", "db3", "MCAP"),
    ),
    HostileClass(
        "text tables of 250 MB",
        "`drivers/core/reading_process.py`",
        "`tests/daq/importers/test_bounds.py`",
        [
            ("x.csv", f"import x.csv {IMPORT}", lambda path: _write(path, b"t,q1\n" + b"1,2\n" * 62_000_000)),
            ("x.csv", f"import x.csv {IMPORT}", lambda path: _write(path, b"\n" * 249_000_000)),
            ("x.csv", f"import x.csv {IMPORT}", lambda path: _write(path, b"t," * 124_000_000)),
        ],
        ("CSV",),
    ),
    HostileClass(
        "YAML and JSON: aliases, depth, long lists, other types",
        "`drivers/core/validation.py`, `ident/result/schema.py`",
        "`tests/daq/robot/test_robot_refused.py`, `tests/ident/result/test_result.py`",
        [
            ("x.yaml", "check x.yaml", text(aliases())),
            ("x.yaml", "check x.yaml", text("name: " + "[" * 490_000)),
            ("x.yaml", "check x.yaml", text(f"x: [{'1,' * 245_000}1]")),
            ("x.json", "validate x.json run.h5", text('{"a": [' + "[]," * 16_000_000 + "[]]}")),
            ("x.json", "validate x.json run.h5", text("[" * 20_000_000)),
            ("fourier.yaml", "record arm.yaml --trajectory fourier.yaml -o out.h5", text(samples_of(60_000))),
        ],
        ("robot file", "trajectory", "result", "limits", "DBC"),
    ),
    HostileClass(
        "URDF: links, depth, entities",
        "`daq/robot/urdf_check.py`",
        "`tests/daq/robot/test_urdf_robot.py`",
        [
            ("x.urdf", "check x.urdf", text(many_links())),
            ("x.urdf", "check x.urdf", text("<a>" * 3_300_000)),
            (
                "x.urdf",
                "check x.urdf",
                text(URDF.replace("<collision>", "<collision></collision>" * 200_000 + "<collision>")),
            ),
        ],
        ("URDF", "mesh"),
    ),
    HostileClass(
        "absurd numbers",
        "`drivers/core/ranges.py`",
        "`tests/ident/test_ranges.py`",
        [
            *(("unused", line, nothing) for line in NUMBERS),
            *(
                ("x.yaml", "check x.yaml", text(ROBOT.replace(old, new)))
                for old, new in (
                    ("d: 0.4", "d: 1e200"),
                    ("d: 0.4", f"d: 0.{'4' * 5000}"),
                    ("velocity: 2", "velocity: 1e308"),
                    ("[-3, 3]", "[-1e308, 1e308]"),
                )
            ),
            ("x.urdf", "check x.urdf", text(URDF.replace("0.4 0 0", "1e308 0 0"))),
            ("x.urdf", "check x.urdf", text(URDF.replace("0 0 1", "0 0 0"))),
        ],
    ),
    HostileClass(
        "legitimate, and as large as allowed",
        "sizes in `drivers/core/files.py`, counts in `drivers/core/ranges.py`; progress is shown",
        "–",
        [
            ("x.yaml", "check x.yaml", text(fifty_joints())),
            ("x.csv", f"import x.csv {IMPORT} --repair drop-duplicates --repair sort", large_csv),
        ],
    ),
)


def main() -> None:
    tried: Counter[str] = Counter()
    for name in sys.argv[1:]:
        tried.update(json.loads(Path(name).read_text())["files"]["commands"])
    load_all_modules()
    print("| class | mechanism | property test | cases by hand | damaged files | worst: time, memory |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        sound = Path(folder, "sound")
        sound.mkdir()
        make_seeds(sound)
        for one in CLASSES:
            outcomes = [_tried(sound, *case) for case in one.cases]
            worst = max(outcomes, key=lambda outcome: outcome.seconds)
            memory = max(outcome.memory for outcome in outcomes)
            damaged = sum(tried[kind] for kind in one.kinds)
            print(
                f"| {one.name} | {one.mechanism} | {one.test} | {len(outcomes)} | {damaged or '–'} |"
                f" {worst.seconds:.1f} s, {memory / 1e9:.2f} GB |",
                flush=True,
            )


def _tried(sound: Path, file: str, line: str, make: Make) -> Outcome:
    """The outcome of one case; the file is removed again."""
    path = sound / file
    kept = path.read_bytes() if path.is_file() else None
    path.unlink(missing_ok=True)
    make(path)
    before = set(sound.iterdir())
    outcome = run_command(line.split(), sound)
    for made in set(sound.iterdir()) - before:
        if made.is_dir():
            shutil.rmtree(made)
        else:
            made.unlink()
    path.unlink(missing_ok=True)
    if kept is not None:
        path.write_bytes(kept)
    said = (outcome.errors.splitlines() or [""])[0][:200]
    print(f"{line}: {outcome.status}, {outcome.seconds:.1f} s, {outcome.memory / 1e9:.2f} GB: {said}", file=sys.stderr)
    if outcome.problems:
        print(f"  {'; '.join(outcome.problems)}", file=sys.stderr)
    return outcome


if __name__ == "__main__":
    main()
