"""Second-order sections of digital low-pass filters.

Equal to `scipy.signal.butter` and `cheby1` with output="sos", whose import alone takes a second of CPU.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.core.arrays import FloatArray


def low_pass_sections(order: int, cutoff: float, ripple: float = 0.0) -> FloatArray:
    """Sections (S, 6) of a Butterworth low-pass, or of a Chebyshev one of type I where there is a ripple.

    The poles of the analogue prototype lie on a circle or an ellipse (Oppenheim and Schafer, Discrete-Time Signal
    Processing, appendix B); the bilinear transform maps them into the unit circle and all zeros to −1.

    Args:
        order: number of poles.
        cutoff: half power, or the end of the ripple [cycles a sample], below one half.
        ripple: of the passband [dB].
    """
    angles = 1j * np.pi * np.arange(1 - order, order, 2) / (2 * order)
    excess = math.sqrt(10.0 ** (ripple / 10.0) - 1.0)
    prototype = -np.sinh(math.asinh(1.0 / excess) / order + angles) if ripple else -np.exp(angles)
    lowered = 1.0 / math.hypot(1.0, excess) if order % 2 == 0 else 1.0  # at rest an even order is in a trough
    gain = lowered * float(np.prod(-prototype).real)
    warped = 4.0 * math.tan(math.pi * cutoff)
    poles = warped * prototype
    gain *= warped**order / float(np.prod(4.0 - poles).real)
    poles = (4.0 + poles) / (4.0 - poles)
    sections = np.zeros(((order + 1) // 2, 6))
    # Upper half plane; the most damped pole comes first, and with an odd order it is real.
    for section, pole in zip(sections, poles[: len(sections)][::-1].tolist(), strict=True):
        section[:] = (1.0, 2.0, 1.0, 1.0, -2.0 * pole.real, abs(pole) ** 2)
    if order % 2:
        sections[0] = (1.0, 1.0, 0.0, 1.0, -poles[order // 2].real, 0.0)
    sections[0, :3] *= gain
    return sections
