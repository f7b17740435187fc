"""The worst error bar to expect of a motion, quick enough to be reported during the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.excite.criteria import RegressorCriterion
from ident.excite.path import JointPath
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT


@dataclass(frozen=True)
class ErrorBar:
    """Expected 95 % interval of one parameter.

    Attributes:
        name: of the base parameter.
        percent: half of the interval, of the parameter's size [%].
    """

    name: str
    percent: float


@dataclass(frozen=True)
class ErrorBars:
    """Expected error bars of weighted least squares, as √(A⁻¹)_ii (SR400 eq. 14).

    Attributes:
        criterion: with the columns and the weights 1/σ_j of the joints' noise.
        names: (b,) of the columns' parameters.
        sizes: (b,) of the parameters: their prior values, at least a share of the largest of its kind.
        values: independent values of the noise per joint in the motion.
    """

    criterion: RegressorCriterion
    names: Sequence[str]
    sizes: FloatArray
    values: float

    def worst(self, path: JointPath) -> ErrorBar:
        """The worst of all parameters along one repetition at full speed; infinite where one is not excited."""
        information = self.criterion.information(path) * np.outer(self.sizes, self.sizes)
        try:
            variances = np.diag(np.linalg.inv(information)) / self.values
        except np.linalg.LinAlgError:
            variances = np.full(len(self.names), np.inf)
        variances = np.where(variances > 0.0, variances, np.inf)
        worst = int(np.argmax(variances))
        return ErrorBar(self.names[worst], 100.0 * WITHIN_95_PERCENT * float(np.sqrt(variances[worst])))
