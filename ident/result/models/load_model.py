"""Reading back what `identify` wrote, as a model."""

from __future__ import annotations

from os import PathLike
from typing import get_args

from drivers.core.errors import UsageError
from ident.result.delivered import Parameters
from ident.result.gravity import read_gravity_result
from ident.result.models.gravity_model import GravityModel
from ident.result.models.model import Model, result_path
from ident.result.result_file import GRAVITY, kind_of, read_result


def load_model(path: str | PathLike[str], parameters: Parameters | None = None) -> Model:
    """The model that `identify` wrote.

    Args:
        path: a folder that `identify`, `merge` or `result.save` wrote, or its result.json.
        parameters: "consistent", those of bodies that can exist, with an inertia matrix that is always positive
            definite; "full", every base parameter as estimated; "essential", the significant ones, the others 0. None
            takes the model that the verdict grades: consistent where there is one, else full.

    Returns:
        The model; a `GravityModel`, which knows gravity alone, of what `identify --gravity` wrote.

    Raises:
        ResultFileError: no such file, or it is no result.
        UsageError: there are no such parameters in it.
        ModelError: the recordings identify only some of the base parameters.

    Example:
        >>> import dynid, tempfile
        >>> run = dynid.simulate("ur5e", duration=10.0, seed=1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     dynid.identify(run).save(folder)
        ...     model = dynid.load_model(folder, parameters="essential")
        >>> model.gravity([0.0] * 6).shape
        (6,)
    """
    if parameters is not None and parameters not in get_args(Parameters):
        raise UsageError(f"there are no '{parameters}' parameters", hint="consistent, full or essential")
    file = result_path(path)
    if kind_of(file) == GRAVITY:
        if parameters is not None:
            raise UsageError("a model of gravity has one set of parameters", where=str(path), hint="leave it out")
        return GravityModel(read_gravity_result(file))
    return Model(read_result(file), parameters)
