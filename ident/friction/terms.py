"""Friction terms of an arm's motors, their shapes, and what friction depends on along a motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from daq.robot.schema import FRICTION_TERMS, Friction
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from drivers.core.text import did_you_mean
from ident.friction.table import OPTIONS, SHAPED, SHAPES, TERM, FrictionOption, Shape, term_of

Motion = tuple[tuple[int, float], ...]
"""(joint, factor) of the active joints that a motion is made of; Σ factor · q̇."""

States = Mapping[Motion, FloatArray]
"""Presliding states (…, m) in place of sign(q̇), by the motion that rubs (`ident.model.presliding`)."""

NO_STATES: States = {}


@dataclass(frozen=True)
class LoadTorque:
    """Parameters whose gravity torque the load-dependent friction follows (AUBO eq. 18)."""

    columns: tuple[int, ...]  # standard columns of links' parameters
    values: tuple[float, ...]  # of them; those of base parameters from an earlier estimate


@dataclass(frozen=True)
class FrictionTerms:
    """Friction of n motors beside viscous, Coulomb and offset, and the shapes of all terms."""

    # of each motor, the kinds of its further columns; empty where no motor has any
    kinds: tuple[tuple[str, ...], ...] = ()
    # each motor's value, by the name of the shape; a shape that is not here is the plain or the first one
    shapes: dict[str, tuple[float, ...]] = field(default_factory=dict)
    # whether each motor's shape is estimated, by its name; one that is not here is not
    free: dict[str, tuple[bool, ...]] = field(default_factory=dict)
    load_torque: LoadTorque | None = None  # what the load torque follows from; without it there is no load column
    # whether there are columns for the derivatives by the free shapes, through which a regression takes them for
    # unknown: their parameters are a coefficient times a small change of its shape
    sensitivities: bool = False

    def has(self, kind: str, motor: int) -> bool:
        """Return whether a motor has a column of this further kind."""
        if kind in SHAPED:
            return self.sensitivities and self.is_free(kind, motor)
        return self.asks(kind, motor) and (TERM[kind].needs != "load" or self.load_torque is not None)

    def asks(self, kind: str, motor: int) -> bool:
        """Return whether a motor is to have a column of this further kind, once its load torque is known."""
        return bool(self.kinds) and kind in self.kinds[motor]

    def shape(self, name: str, motor: int) -> float:
        """A motor's value of the shape of this name."""
        if name in self.shapes:
            return self.shapes[name][motor]
        shape = SHAPES[name]
        return shape.first if shape.plain is None else shape.plain

    def shape_of(self, kind: str, motor: int) -> float:
        """Value of the shape of a motor's column of some kind; 1 where its term has none."""
        shape = term_of(kind).shape
        return 1.0 if shape is None else self.shape(shape.name, motor)

    def is_free(self, name: str, motor: int) -> bool:
        """Return whether a motor's shape of this name is estimated."""
        return name in self.free and self.free[name][motor]

    def bent(self, name: str, motor: int) -> bool:
        """Return whether a motor's shape of this name is another than the plain one, or is to be."""
        return self.is_free(name, motor) or self.shape(name, motor) != SHAPES[name].plain

    @property
    def shaped(self) -> bool:
        """Return whether some shape is to be estimated."""
        return any(any(free) for free in self.free.values())

    @property
    def loaded(self) -> bool:
        """Return whether some friction is to follow a load torque, known or not."""
        return any(TERM[kind].needs == "load" for kinds in self.kinds for kind in kinds)

    @property
    def plain(self) -> bool:
        """Return whether there is no further column, and no shape but plain ones."""
        bent = (
            value != shape.plain
            for name, shape in SHAPES.items()
            if shape.plain is not None
            for value in self.shapes.get(name, ())
        )
        return not any(self.kinds) and not self.shaped and not any(bent)

    def free_shapes(self) -> Iterator[tuple[Shape, int]]:
        """Each shape that is estimated, with its motor."""
        for name, shape in SHAPES.items():
            yield from ((shape, motor) for motor, wanted in enumerate(self.free.get(name, ())) if wanted)

    def without_free_shapes(self) -> FrictionTerms:
        """The terms without those whose shape is estimated, and plain ones in place of bent ones."""
        terms = self
        for shape, motor in self.free_shapes():
            if shape.plain is None:
                terms = terms.with_kinds(motor, (), (SHAPED[shape.name].kind,))
            terms = terms.with_shape(shape.name, motor, shape.first if shape.plain is None else shape.plain)
        return terms

    def with_kinds(self, motor: int, kinds: Sequence[str], without: Sequence[str] = ()) -> FrictionTerms:
        """The terms with further columns of a motor, and without others."""
        kept = {*self.kinds[motor], *kinds} - set(without) | set(kinds)
        own = tuple(kind for kind in TERM if kind in kept)
        return replace(self, kinds=(*self.kinds[:motor], own, *self.kinds[motor + 1 :]))

    def with_shape(self, name: str, motor: int, value: float, *, free: bool = False) -> FrictionTerms:
        """The terms with another value of a motor's shape, known or to be estimated."""
        count = range(len(self.kinds))
        values = tuple(value if index == motor else self.shape(name, index) for index in count)
        frees = tuple(free if index == motor else self.is_free(name, index) for index in count)
        return replace(self, shapes={**self.shapes, name: values}, free={**self.free, name: frees})

    def with_option(self, option: FrictionOption, motor: int, value: float | None = None) -> FrictionTerms:
        """The terms with what an option of `--friction` names.

        Args:
            option: of `ident.friction.table`.
            motor: which gets it.
            value: of its shape, known; None for one that is to be estimated.
        """
        group = {kind for other in OPTIONS if other.group == option.group for kind in other.kinds}
        terms = self if option.bends else self.with_kinds(motor, option.kinds, tuple(group))
        shape = TERM[option.kinds[0]].shape
        if shape is None:
            return terms
        own = option.shape if value is None else value
        return terms.with_shape(shape.name, motor, shape.first if own is None else own, free=own is None)

    def option(self, group: str, motor: int) -> FrictionOption | None:
        """Return what a motor has of a group of options; None where it has nothing of it."""
        for option in OPTIONS:
            if option.group != group:
                continue
            shape = TERM[option.kinds[0]].shape
            if option.bends:
                if shape is not None and self.bent(shape.name, motor):
                    return option
                continue
            own = [kind for other in OPTIONS if other.group == group for kind in other.kinds if self.asks(kind, motor)]
            if set(own) == set(option.kinds) and option.shape in (None, self.shape_of(option.kinds[0], motor)):
                return option
        return None


NO_TERMS = FrictionTerms()
"""No further friction."""


@dataclass(frozen=True)
class FrictionConditions:
    """What friction depends on beside the velocity; None where the model asks for neither."""

    load_torque: FloatArray | None = None  # (n, m) of the motors [N·m or N]
    temperature: FloatArray | None = None  # (n, m) of the motors' joints [K]
    presliding: States = field(default_factory=dict)  # states in place of sign(q̇)
    position: FloatArray | None = None  # (n, m) of the joints with a motor [rad or m]


def friction_terms(friction: Friction, joint_names: Sequence[str]) -> FrictionTerms:
    """The further friction that a robot file's section asks for.

    Raises:
        RobotFileError: `terms` names none.
    """
    terms = no_terms(len(joint_names))
    for motor, name in enumerate(joint_names):
        joint = friction.joints.get(name)

        def chosen(key: str, joint: Any = joint) -> Any:
            value = None if joint is None else getattr(joint, key)
            return getattr(friction, key) if value is None else value

        words = chosen("terms")
        _check_words(words)
        for option in OPTIONS:
            shape, keyed = TERM[option.kinds[0]].shape, option.group in FRICTION_TERMS
            stated = chosen(option.group) if keyed else None
            bent = option.bends and shape is not None and stated != shape.plain
            if option.word not in words and not (keyed and (stated == option.value or bent)):
                continue
            value = chosen(shape.name) if shape is not None and shape.name in FRICTION_TERMS else "estimated"
            unknown = value == "estimated" or (option.bends and not bent)
            terms = terms.with_option(option, motor, None if unknown else float(value))
    return NO_TERMS if terms.plain else terms


def _check_words(words: Sequence[str]) -> None:
    allowed = tuple(option.word for option in OPTIONS)
    for word in words:
        if word not in allowed:
            hint = did_you_mean(word, allowed) or f"terms are {', '.join(allowed)}"
            raise RobotFileError(f"no friction term is called '{word}'", where="friction: terms", hint=hint)


def no_terms(dof: int) -> FrictionTerms:
    """No further friction of n motors, as a start from which terms are added."""
    return FrictionTerms(((),) * dof)
