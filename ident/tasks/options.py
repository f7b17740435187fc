"""What each task is given: the arguments of the Python API and the options of its command, declared once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from drivers.core.errors import UsageError
from drivers.core.options import Options, argument, option, read_names, read_numbers
from drivers.core.ranges import Range
from ident.excite.choices import DesignChoices, GravityChoices, SearchOptions, ServoMotionChoices, SweepChoices
from ident.identify.options import ColumnOptions
from ident.monitor.choices import BANDWIDTH, Kind
from ident.regression.options import PERCENT, EssentialOptions, ExperimentChoices, ReversalOptions
from ident.signals.options import FilterOptions, WindowOptions, delay_option

if TYPE_CHECKING:
    from os import PathLike

    from daq.robot.loader import RobotFile
    from drivers.core.arrays import FloatArray
    from drivers.core.reading_process import Progress
    from ident.excite.search.search import SearchResult
    from ident.result.delivered import Parameters
    from ident.tasks.arguments import Limits, Run, Runs
    from ident.tasks.excitation import ExcitationTrajectory
    from ident.tasks.validation import Identified

_RUNS = argument(
    "recordings",
    "Recordings (.h5) of one arm; several are stacked.",
    meaning="a recording, or several of one arm, which stack; each read already or a path.",
    command_type=list[Path],
)
MODEL_HELP = "Folder that identify wrote, or its result.json."
OBSERVER_BANDWIDTH = Range(1.0, 1000.0, "1/s")
ALARM_RATE = Range(1e-3, 1e4, "1/h")
"""False alarms per hour."""
_PROGRESS = "called with the name of each step before it begins."


def _robot_option() -> str | Path | RobotFile | None:
    return option(None, "Robot file instead of the recording's own.")


def _split_option() -> float | None:
    return option(None, "Identify on the data before this time, validate on the rest [s].")


def silent(step: object) -> None:
    """A progress callback that shows nothing."""


def _progress_option() -> Progress:
    return option(silent, meaning=_PROGRESS)


def _accept_option() -> Limits | None:
    return option(
        None,
        meaning='limits that the model must keep on held-out data, such as {"relative_error": 0.08}, or the path of a '
        "YAML file with them; the outcome is `acceptance`.",
    )


@dataclass(frozen=True, kw_only=True)
class DataOptions(Options):
    """Method and data of an identification."""

    method: str = option(
        "wls",
        "Estimator with its options, such as wls or energy:window=0.5; 'help' lists them.",
        meaning='estimator, NAME[:OPTION=VALUE]…, such as "wls" or "energy:window=0.5"; docs/identification.md lists '
        "them, and so does `dynid identify --method help`.",
        metavar="NAME[:OPTION=VALUE]…",
    )
    validation: Runs = option(
        (),
        "Held-out recording, repeatable; default: the last 30 % of each of the others.",
        flag="--validate",
        command_type=list[Path],
    )
    split: float | None = _split_option()
    robot: str | Path | RobotFile | None = _robot_option()


@dataclass(frozen=True)
class IdentifyOptions(
    EssentialOptions, WindowOptions, ReversalOptions, ExperimentChoices, FilterOptions, ColumnOptions, DataOptions
):
    """Arguments of `identify`; of a dataclass with several bases, the last one's fields come first."""

    runs: Runs = field(metadata=_RUNS)
    _: KW_ONLY
    accept: Limits | None = _accept_option()
    progress: Progress = _progress_option()


@dataclass(frozen=True)
class CompareOptions(Options):
    """Arguments of `compare`."""

    runs: Runs = field(metadata=_RUNS)
    methods: Sequence[str] = option(
        ("ols", "wls"), "Methods, as identify takes them.", metavar="A,B,…", read=read_names, shown="ols,wls"
    )
    _: KW_ONLY
    friction: Sequence[str] = option(
        (),
        "Friction models, as identify takes them, each with each method; default: the robot file's.",
        metavar="A,B,…",
        read=read_names,
    )
    validation: Runs = option(
        (),
        "Held-out recording, repeatable, each judged separately; default: the last 30 % of the others.",
        flag="--validate",
        command_type=list[Path],
    )
    split: float | None = _split_option()
    robot: str | Path | RobotFile | None = _robot_option()
    delay: float | None = delay_option()
    scheduler: str = option("", "Identify on a Dask cluster (tcp://host:8786).")
    progress: Progress = _progress_option()

    def __post_init__(self) -> None:
        """Check every option, and that both lists are lists of different names; a UsageError names the list."""
        for names, name, example in (
            (self.methods, "methods", '("ols", "wls")'),
            (self.friction, "friction", '("coulomb",)'),
        ):
            if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(n, str) for n in names):
                raise UsageError(f"{name} must be a list of names", hint=f"{name}={example}")
            if len(set(names)) < len(names):
                raise UsageError(f"a name is given twice: {', '.join(names)}", where=name)
        if not self.methods:
            raise UsageError("no method to compare", hint='methods=("ols", "wls")')
        super().__post_init__()


@dataclass(frozen=True)
class FrictionOptions(Options):
    """Arguments of `friction`."""

    runs: Runs = field(
        metadata=argument(
            "recordings",
            "Recordings (.h5) of one arm, one joint moving at a time.",
            meaning="a recording, or several of one arm; each read already or a path.",
            command_type=list[Path],
        )
    )
    _: KW_ONLY
    friction: str = option(
        "auto",
        "coulomb-viscous+power+temperature, …, or auto; see docs.",
        meaning='terms as `identify` takes them, such as "coulomb-viscous+power+temperature"; or "auto", which chooses '
        "those of each joint by held-out error. Temperature and load terms need recordings that span enough.",
    )
    robot: str | Path | RobotFile | None = _robot_option()
    delay: float | None = delay_option()
    progress: Progress = _progress_option()


@dataclass(frozen=True)
class LoadOptions(Options):
    """Arguments of `payload`: a run without and a run with a load, and what is known of it."""

    free: Run = field(metadata=argument("free", "Recording (.h5) of the arm without the load.", command_type=Path))
    loaded: Run = field(
        metadata=argument("loaded", "Recording (.h5) of the same arm with the load.", command_type=Path)
    )
    _: KW_ONLY
    mass: float | None = option(None, "Mass of the load, where it was weighed [kg].")
    com: Sequence[float] | FloatArray | None = option(
        None, "Centre of mass x, y, z of the load in the tool frame [m].", metavar="X,Y,Z", read=read_numbers
    )
    inertia: Sequence[float] | FloatArray | None = option(
        None,
        "Inertia of the load about its centre of mass: xx, xy, xz, yy, yz, zz [kg·m²].",
        metavar="XX,XY,XZ,YY,YZ,ZZ",
        read=read_numbers,
    )
    robot: str | Path | RobotFile | None = option(None, "Robot file instead of the free recording's own.")
    delay: float | None = delay_option()

    def __post_init__(self) -> None:
        """Check every option, and that a load that is described has a mass; a UsageError names the option."""
        super().__post_init__()
        if self.mass is None and (self.com is not None or self.inertia is not None):
            raise UsageError("com and inertia describe a load whose mass is missing", hint="give its mass too [kg]")


@dataclass(frozen=True)
class GainsOptions(LoadOptions):
    """Arguments of `drive_gains`, which needs the mass."""

    _: KW_ONLY
    up_and_down: bool = option(False, "Identify from slow passes of one joint at a time, up and down.")

    def __post_init__(self) -> None:
        """Check every option, and that there is a mass; a UsageError names the option."""
        super().__post_init__()
        if self.mass is None:
            raise UsageError(
                "the gains are not identifiable without the load's mass: twice the gains with twice the masses fit "
                "equally well",
                hint="weigh the load and add --mass KG",
            )


@dataclass(frozen=True)
class PredictOptions(Options):
    """Arguments of `predict`."""

    identified: Identified = field(
        metadata=argument(
            "model",
            MODEL_HELP,
            meaning="a result, a model (its own parameters count), or the folder or file of a result.",
            command_type=Path,
        )
    )
    run: Run = field(
        metadata=argument(
            "recording",
            "Recording of the same arm (.h5), or a trajectory file (.yaml).",
            meaning="a recording of the same arm, or its path; without a recorded torque there is no residual. Or the "
            "path of a trajectory file: as if the arm followed it exactly; filtered as at the identification.",
            command_type=Path,
        )
    )
    _: KW_ONLY
    parameters: Parameters | None = option(
        None, "consistent, full or essential; default: consistent if available, else full."
    )


@dataclass(frozen=True, kw_only=True)
class DetectionOptions(Options):
    """How contacts are noticed, and what thresholds are earned on."""

    quiet: Runs | None = option(
        None,
        "Recording without contact that thresholds are learnt from; repeatable; default: those of the model.",
        command_type=list[Path],
    )
    observer: Kind = option("direct", "momentum, direct or kalman.", one_of=get_args(Kind))
    bandwidth: float | None = option(
        None,
        f"Bandwidth of the observer [1/s]; default: {BANDWIDTH['direct']:g}, of kalman {BANDWIDTH['kalman']:g}.",
        allowed=OBSERVER_BANDWIDTH,
    )
    false_alarms: float = option(1.0, "Allowed false alarms per hour.", allowed=ALARM_RATE)


@dataclass(frozen=True)
class MonitorOptions(DetectionOptions):
    """Arguments of `monitor`."""

    identified: Identified = field(
        metadata=argument("model", "", meaning="a result, a model, or the folder or file of a result.")
    )
    run: Run = field(metadata=argument("recording", "", meaning="a recording of the same arm, or its path."))
    _: KW_ONLY
    contacts: str | PathLike[str] | None = option(
        None,
        meaning="CSV file with columns start and end, in seconds from the first sample: contacts that should be found.",
    )


@dataclass(frozen=True)
class ValidateOptions(Options):
    """Arguments of `validate`."""

    identified: Identified = field(
        metadata=argument(
            "result", MODEL_HELP, meaning="a result, a model, or the folder or file of one.", command_type=Path
        )
    )
    runs: Runs = field(
        metadata=argument(
            "recordings",
            "Held-out recordings (.h5), each judged separately.",
            meaning="a held-out recording or several, or their paths.",
            command_type=list[Path],
        )
    )
    _: KW_ONLY
    accept: Limits | None = _accept_option()


@dataclass(frozen=True, kw_only=True)
class _MergedOptions(Options):
    """Data of a merge."""

    validation: Run | None = option(
        None, "Held-out recording (.h5) that none of them used.", flag="--validate", command_type=Path
    )


@dataclass(frozen=True)
class MergeOptions(EssentialOptions, _MergedOptions):
    """Arguments of `merge`."""

    results: Sequence[Identified] = field(
        metadata=argument(
            "models",
            "result.json files of one arm, or the folders that hold them.",
            meaning="results, models, or the folders or files of them.",
            command_type=list[Path],
        )
    )


@dataclass(frozen=True)
class InfoOptions(Options):
    """Arguments of `info`."""

    run: Run = field(metadata=argument("recording", "Recording (.h5).", command_type=Path))
    _: KW_ONLY
    robot: str | Path | RobotFile | None = _robot_option()
    wanted_rsd: float | None = option(
        None,
        "Estimate how long to record this motion for this relative standard deviation [%].",
        allowed=PERCENT,
        hint="5 is usual",
    )
    progress: Progress = _progress_option()


_ROBOT = argument(
    "robot", "Built-in robot or robot file.", meaning="built-in name, robot file, URDF, or the result of `load_robot`."
)


@dataclass(frozen=True)
class ExciteOptions(SearchOptions, DesignChoices):
    """Arguments of `design_excitation`."""

    robot: str | Path | RobotFile = field(metadata=_ROBOT)
    _: KW_ONLY
    earlier: ExcitationTrajectory | str | PathLike[str] | None = option(
        None, "Trajectory to improve, or its file.", flag="--from", command_type=Path
    )
    prior: str | Path | None = option(
        None, "Model folder or result.json with prior parameters and noise.", command_type=Path
    )
    progress: Callable[[SearchResult], None] = option(
        silent, meaning="called after each better motion, and a few times per second."
    )

    def __post_init__(self) -> None:
        """Check every option, and that the search ends in one way; a UsageError names the option."""
        super().__post_init__()
        if self.time is not None and self.starts is not None:
            raise UsageError(
                "--time and --starts exclude each other", hint="--starts does not depend on the machine's speed"
            )


@dataclass(frozen=True)
class ServoMotionOptions(ServoMotionChoices):
    """Arguments of `design_servo_motion`."""

    robot: str | Path | RobotFile = field(metadata=_ROBOT)


@dataclass(frozen=True)
class GravityMotionOptions(GravityChoices):
    """Arguments of `design_gravity_motion`."""

    robot: str | Path | RobotFile = field(metadata=_ROBOT)
    _: KW_ONLY
    prior: str | Path | None = option(
        None,
        "Model folder or result.json that predicts torque and its noise; default: the robot file's truth.",
        command_type=Path,
    )


@dataclass(frozen=True)
class SweepOptions(SweepChoices):
    """Arguments of `design_sweep`."""

    robot: str | Path | RobotFile = field(metadata=_ROBOT)
    _: KW_ONLY
    prior: str | Path | None = option(
        None, "Model folder or result.json that predicts torque; default: the robot file's truth.", command_type=Path
    )
