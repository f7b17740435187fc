"""Choice of each joint's friction terms (`--friction auto`), and the start of the search for their shapes.

Joint by joint, one term is added at a time: that which most lowers the error on blocks held out of the identification
data, all columns fitted to the others, shapes included. A step counts if the held-out error falls and the partial
F-test, with as many equations as the autocorrelated residuals are worth, rejects chance at `LEVEL`. No friction
coefficient may be negative: the consistent model, which is delivered, could not have it. Validation data take no part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import OPTIONS, POSITION_KINDS, TERM
from ident.friction.terms import FrictionTerms
from ident.identify.friction.candidates import CandidateGrams, solve_columns, squared_error
from ident.regression.least_squares import LEAST_TORQUE, RESIDUAL_FLOOR
from ident.result.friction import FrictionStep

LEVEL = 0.05
"""Significance level of the F-test, that of AUBO Table II."""

OPTION = {option.word: option for option in OPTIONS}
"""Terms that can be added, by their words."""


@dataclass(frozen=True)
class _Addition:
    """One way to add a term: the candidates it brings, and the base column that it replaces."""

    candidates: tuple[int, ...]
    dropped: int | None = None
    shape: float | None = None


class FrictionSearch:
    """Choices of columns on candidate Gram matrices.

    Args:
        grams: of the data.
        active: base columns that the data identify.
        viscous, coulomb: of each motor its base column of this kind; None where it has none.
        used: motors whose torque is used.
        shares: (n,) of each motor's equations, how many independent ones they are worth.
    """

    def __init__(
        self,
        grams: CandidateGrams,
        active: Sequence[int],
        viscous: Sequence[int | None],
        coulomb: Sequence[int | None],
        used: Sequence[int],
        shares: FloatArray,
    ) -> None:
        self._grams, self._active, self._used, self._shares = grams, active, used, shares
        self._viscous, self._coulomb = viscous, coulomb
        self._added: dict[tuple[int, str], _Addition] = {}
        self._reweight(np.isin(np.arange(len(grams.grams)), used).astype(np.float64))

    def _reweight(self, weights: FloatArray) -> None:
        """Weights (n,) from the residuals of the present choice, starting from some."""
        rows = self._grams.rows.sum(axis=0)
        for _ in range(3):
            self._weighted = self._grams.weighted(weights)
            self._total = self._weighted.sum(axis=0)
            parameters = solve_columns(self._total, self._columns())
            if parameters is None:
                return
            spread = np.sqrt(self._grams.residual_sums(parameters) / np.maximum(rows, 1.0))
            weights = np.where(weights > 0.0, 1.0 / np.maximum(spread, RESIDUAL_FLOOR * LEAST_TORQUE), 0.0)
        self._weighted = self._grams.weighted(weights)
        self._total = self._weighted.sum(axis=0)

    def _columns(self, motor: int | None = None, further: _Addition | None = None) -> list[int]:
        """Places of the chosen columns, with a further addition for a motor."""
        additions = [(at, addition) for (at, _), addition in self._added.items()]
        if motor is not None and further is not None:
            additions.append((motor, further))
        dropped = {addition.dropped for _, addition in additions}
        extra = [self._grams.index(at, place) for at, addition in additions for place in addition.candidates]
        return [column for column in self._active if column not in dropped] + extra

    def ways(self, motor: int, term: str) -> list[_Addition]:
        """The ways to add a term to a motor: one, or one per shape on the grid; none where it is not to be had."""
        option, of = OPTION[term], self._grams.candidates[motor]
        places = [[at for at, candidate in enumerate(of) if candidate.quantity == kind] for kind in option.kinds]
        shape = TERM[option.kinds[0]].shape
        if shape is None:
            added = tuple(place for of_kind in places for place in of_kind)
            return [_Addition(added)] if all(places) else []
        if option.shape is not None:
            alike = [[place for place in of_kind if of[place].shape == option.shape] for of_kind in places]
            return [_Addition(together) for together in zip(*alike, strict=True)]
        replaced = self._viscous[motor] if option.bends else None
        if option.bends and replaced is None:
            return []
        return [_Addition((place,), replaced, of[place].shape) for place in places[0]]

    def best(
        self, motor: int, ways: Sequence[_Addition], gram: FloatArray
    ) -> tuple[float, _Addition | None, FloatArray]:
        """Smallest squared error of a Gram matrix (d, d), the addition behind it, and the values (d − 1,)."""
        lowest: tuple[float, _Addition | None, FloatArray] = (float("inf"), None, np.zeros(len(gram) - 1))
        for way in ways:
            parameters = solve_columns(gram, self._columns(motor, way))
            if parameters is None or not self._brakes(motor, way, parameters):
                continue
            if (error := squared_error(gram, parameters)) < lowest[0]:
                lowest = (error, way, parameters)
        return lowest

    def _brakes(self, motor: int, way: _Addition, parameters: FloatArray) -> bool:
        """Whether no friction of a motor is negative, that of the temperature aside, once it has a further term."""
        additions = (way, *(addition for (at, _), addition in self._added.items() if at == motor))
        of = self._grams.candidates[motor]
        added = {place for addition in additions for place in addition.candidates if TERM[of[place].quantity].brakes}
        rubbing = [
            parameters[self._grams.index(motor, place)]
            for addition in additions
            for place in addition.candidates
            if of[place].quantity in POSITION_KINDS and TERM[of[place].quantity].rubs
        ]
        coulomb = self._coulomb[motor]
        if rubbing and coulomb is not None and np.linalg.norm(rubbing) > parameters[coulomb]:
            return False
        if not added:
            return True
        dropped = {addition.dropped for addition in additions}
        plain = {self._viscous[motor], self._coulomb[motor]} - dropped - {None}
        columns = [column for column in plain if column is not None]
        return all(
            parameters[column] >= 0.0 for column in (*columns, *(self._grams.index(motor, place) for place in added))
        )

    def held_out(self, motor: int, ways: Sequence[_Addition]) -> FloatArray:
        """Squared error (FOLDS,) on each fold of what fits the other folds best."""
        errors = []
        for fold in self._weighted:
            _, way, parameters = self.best(motor, ways, self._total - fold)
            errors.append(float("inf") if way is None else squared_error(fold, parameters))
        return np.array(errors)

    def add(self, motor: int, term: str, addition: _Addition) -> None:
        """Keep an addition."""
        self._added[motor, OPTION[term].group] = addition

    def judge_by(self, shares: FloatArray) -> None:
        """Take how many independent equations each motor's are worth (n,) from elsewhere."""
        self._shares = shares

    def confounded(self, motor: int, term: str, share: float) -> bool:
        """Whether some combination of a term's candidates has a smaller share of its length independent of the others.

        Of a term without a shape to be found.
        """
        (way,) = self.ways(motor, term)
        own = [self._grams.index(motor, place) for place in way.candidates]
        chosen = self._columns()
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self._total), np.finfo(np.float64).tiny))
        gram = self._total * np.outer(scale, scale)
        shared = gram[np.ix_(chosen, own)]
        left = gram[np.ix_(own, own)] - shared.T @ np.linalg.pinv(gram[np.ix_(chosen, chosen)], hermitian=True) @ shared
        return bool(np.linalg.eigvalsh(left)[0] < share**2)

    def choose(
        self, motor: int, name: str, words: Sequence[str] = tuple(OPTION), level: float = LEVEL
    ) -> list[FrictionStep]:
        """Add terms to a motor as long as one counts."""
        steps: list[FrictionStep] = []
        rows = float(self._grams.rows[:, list(self._used)].sum())
        nothing = [_Addition(())]
        while True:
            before, plain = self.held_out(motor, nothing), self.best(motor, nothing, self._total)[0]
            options = [
                (self.held_out(motor, ways), term, ways)
                for term in words
                if (motor, OPTION[term].group) not in self._added and (ways := self.ways(motor, term))
            ]
            if not options:
                return steps
            after, term, ways = min(options, key=lambda option: float(option[0].sum()))
            fitted, way, _ = self.best(motor, ways, self._total)
            if way is None or not np.isfinite(before.sum() + after.sum()):  # other folds do not determine it
                return steps
            freedom = len(way.candidates) - (way.dropped is not None) + (way.shape is not None)
            independent = max(1.0, float(self._shares[motor]) * rows - len(self._columns(motor, way)))
            variance = max(fitted, np.finfo(np.float64).tiny) / max(1.0, rows - len(self._columns(motor, way)))
            f_value = float(self._shares[motor]) * max(plain - fitted, 0.0) / (freedom * variance)
            p_value = _f_tail(f_value, freedom, independent)
            accepted = bool(after.sum() < before.sum()) and p_value < level
            steps.append(
                FrictionStep(
                    joint=name,
                    term=term,
                    shape=way.shape,
                    f_value=f_value,
                    freedom=freedom,
                    p_value=p_value,
                    error_before=float(np.sqrt(before.sum() / rows)),
                    error_after=float(np.sqrt(after.sum() / rows)),
                    accepted=accepted,
                )
            )
            if not accepted:
                return steps
            self.add(motor, term, way)
            self._reweight(np.where(np.isin(np.arange(len(self._shares)), self._used), 1.0, 0.0))

    def revise(self, motor: int) -> bool:
        """Exchange one added term of a motor for another of its group that holds better beside the rest; whether so."""
        for key, kept in list(self._added.items()):
            others = [term for term, option in OPTION.items() if key == (motor, option.group)]
            del self._added[key]
            errors = {term: self.held_out(motor, ways).sum() for term in others if (ways := self.ways(motor, term))}
            best = min(errors, key=lambda term: errors[term])
            way = self.best(motor, self.ways(motor, best), self._total)[1]
            exchanged = way is not None and len(others) > 1 and way.candidates != kept.candidates
            self._added[key] = way if exchanged and way is not None else kept
            if exchanged:
                self._reweight(np.where(np.isin(np.arange(len(self._shares)), self._used), 1.0, 0.0))
                return True
        return False

    def terms(self, start: FrictionTerms) -> FrictionTerms:
        """The chosen terms, shapes from the grid marked as free, beside those of `start`."""
        for (motor, group), addition in self._added.items():
            kept = [self._grams.candidates[motor][place] for place in addition.candidates]
            kinds = {candidate.quantity for candidate in kept}
            option = next(
                choice
                for choice in OPTIONS
                if choice.group == group and kinds == set(choice.kinds) and choice.shape in (None, kept[0].shape)
            )
            start = start.with_option(option, motor)
            shape = TERM[option.kinds[0]].shape
            if shape is not None and option.shape is None:
                start = start.with_shape(shape.name, motor, kept[0].shape, free=True)
        return start

    def start_shapes(self, motor: int, shapes: Sequence[str]) -> None:
        """Give a motor the terms with these shapes, by name, with the values on the grids that fit best together."""
        self._added = {key: way for key, way in self._added.items() if key[0] != motor}
        words = [
            option.word
            for option in OPTIONS
            for shape in [TERM[option.kinds[0]].shape]
            if shape is not None and shape.name in shapes and option.shape is None
        ]
        least, best = float("inf"), tuple[_Addition, ...]()
        for both in product(*(ways for word in words if (ways := self.ways(motor, word)))):
            dropped = [way.dropped for way in both if way.dropped is not None]
            merged = _Addition(
                tuple(place for way in both for place in way.candidates), dropped[0] if dropped else None
            )
            error = self.best(motor, [merged], self._total)[0]
            if error < least:
                least, best = error, both
        for term, way in zip([word for word in words if self.ways(motor, word)], best, strict=False):
            self.add(motor, term, way)


def _f_tail(f_value: float, freedom: int, independent: float) -> float:
    from scipy.special import fdtrc

    return float(fdtrc(freedom, independent, f_value))
