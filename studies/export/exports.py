"""Exports of models of real and simulated arms, read again and simulated (docs/measurements/export.md).

    python -m studies.export.exports ../shared/data

Identifies the public recordings of the UR10, the Panda and the TX40, and simulated UR5e and SR400, and exports each.
It takes about half a minute.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import dynid

EXAMPLES = Path(__file__).parents[2] / "examples"
UR10 = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
PANDA = tuple(f"joint_{number}" for number in range(1, 8))


def described(name: str, joints: tuple[str, ...], torques: tuple[int, ...]) -> str:
    """A robot file around a URDF."""
    limits = "".join(
        f"  - {{name: {joint}, position: [-6.2832, 6.2832], velocity: 6, torque: {torque}}}\n"
        for joint, torque in zip(joints, torques, strict=True)
    )
    return f"name: {name}\nmodel:\n  urdf: {name}.urdf\n  gravity: [0, 0, -9.81]\njoints:\n{limits}"


def models(data: Path, work: Path) -> dict[str, dynid.Model]:
    """Identified models by what the table calls them."""
    texts = {
        "ur10": described("ur10", UR10, (330, 330, 150, 56, 56, 56)),
        "panda": described("panda", PANDA, (87, 87, 87, 87, 12, 12, 12)),
        "tx40": (EXAMPLES / "tx40.yaml").read_text(encoding="utf-8"),
    }
    for name, text in texts.items():
        (work / f"{name}.yaml").write_text(text, encoding="utf-8")
        (work / f"{name}.urdf").write_bytes((data / f"{name}.urdf").read_bytes())

    def recording(file: str, name: str) -> dynid.Recording:
        return dynid.import_recording(data / file, work / f"{name}.yaml")

    simulated = {name: dynid.identify(dynid.simulate(name, duration=30.0, seed=1)).model for name in ("ur5e", "sr400")}
    return {
        "UR10, recorded": dynid.identify(recording("ur10_unisa1.npz", "ur10")).model,
        "Panda, recorded": dynid.identify(recording("panda_gaz1.npz", "panda"), motor_inertia=False).model,
        "TX40, recorded": dynid.identify(recording("tx40_t1.npz", "tx40"), stop=7.45).model,
        "UR5e, simulated": simulated["ur5e"],
        "SR400, simulated": simulated["sr400"],
    }


def main(data: Path) -> None:
    """Print the table."""
    print("| arm | file, reader | torque difference | energy | off the motion | checks |\n|---|---|---|---|---|---|")
    with TemporaryDirectory() as folder:
        work = Path(folder)
        for arm, model in models(data, work).items():
            urdf = model.export_urdf(work / "arm.urdf", overwrite=True)
            mjcf = model.export_mjcf(work / "arm.xml", overwrite=True)
            for export in (urdf, mjcf):
                checks = ", ".join(check.name for check in export.checks) or "–"
                for reading in export.readings:
                    energies = [percent(one.energy_gain) for one in reading.simulations if one.motion == "unpowered"]
                    errors = [percent(one.tracking_error) for one in reading.simulations if one.motion == "tracking"]
                    cells = (f"{reading.torque_error:.1e}", *(energies or ["–"]), *(errors or ["–"]), checks)
                    print(f"| {arm} | {export.format}, {reading.reader} | {' | '.join(cells)} |", flush=True)


def percent(share: float | None) -> str:
    """A share; `diverges` where a simulation has none."""
    return "diverges" if share is None else f"{100 * share:.2g} %"


if __name__ == "__main__":
    main(Path(sys.argv[1]))
