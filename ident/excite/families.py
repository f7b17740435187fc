"""The families of excitation motions, by the kind of trajectory file that they fill."""

from ident.excite.fourier_families import FourierFamily, FourierQuinticFamily
from ident.excite.points_family import PointsFamily
from ident.excite.sines_family import SinesFamily

__all__ = ["FourierFamily", "FourierQuinticFamily", "PointsFamily", "SinesFamily"]
