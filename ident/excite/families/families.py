"""The families of excitation motions, by the kind of trajectory file that they fill."""

from ident.excite.families.fourier import FourierFamily, FourierQuinticFamily
from ident.excite.families.points import PointsFamily
from ident.excite.families.sines import SinesFamily

__all__ = ["FourierFamily", "FourierQuinticFamily", "PointsFamily", "SinesFamily"]
