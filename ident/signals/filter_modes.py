"""Low-pass filters: their second-order sections, and these run forward and backward as one filter in modal form.

The theory is in filters.py. The sections equal those of `scipy.signal.butter` and `cheby1`, whose import alone takes a
second of CPU.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import ComplexArray, FloatArray


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


@dataclass(frozen=True)
class Modes:
    """The two-sided filter in modal form; one entry per real pole or pair of conjugate ones."""

    pole: ComplexArray  # (m,) λ, upper half plane
    # (m,) r of the filter in one direction, doubled for a pair, so that sums need only the real part
    residue: ComplexArray
    mirrored: ComplexArray  # (m,) g = H(1/λ)
    paired: npt.NDArray[np.bool_]  # (m,) bool, whether the conjugate belongs to it
    offset: ComplexArray  # (m,) 1 − λ without cancellation
    direct: float  # D
    center: float  # h₀

    def one_minus_products(self, conjugate: bool) -> ComplexArray:
        """(m, m) 1 − λᵢλⱼ, or 1 − λᵢλⱼ* where `conjugate`."""
        other = self.offset.conj() if conjugate else self.offset
        return np.asarray(self.offset[:, None] + other - self.offset[:, None] * other)

    def powers(self, exponents: npt.NDArray[np.int64]) -> ComplexArray:
        """(m, len(exponents)) λ to the power of each exponent."""
        return np.asarray(np.power(self.pole[:, None], exponents))


@dataclass(frozen=True)
class ChunkResponse:
    """What a chunk of M samples does: rows (…, M) @ `inward` gives the forward states' gain (2m columns, real and
    imaginary parts in turn), the backward states' gain (2m) and the chunk's own outputs (⌈M / factor⌉); the states
    (…, 2m) @ `forward_out`, `backward_out` give their part of the outputs; `decay` (m,) is λ^M.
    """  # noqa: D205 — the shapes are one sentence

    inward: FloatArray
    forward_out: FloatArray
    backward_out: FloatArray
    decay: ComplexArray


def chunk_response(modes: Modes, length: int, factor: int) -> ChunkResponse:
    """The chunk of `length` samples, the first and then every factor-th of which is kept."""
    time = np.arange(length)
    kept = time[::factor]
    powers = modes.powers(time)
    response = np.empty(length)
    response[0] = modes.center
    response[1:] = ((modes.residue * modes.mirrored) @ powers[:, : length - 1]).real
    return ChunkResponse(
        inward=np.hstack(
            [
                _interleaved(powers[:, ::-1]).T,
                _interleaved(modes.mirrored[:, None] * powers).T,
                response[np.abs(time[:, None] - kept)],
            ]
        ),
        forward_out=_interleaved((modes.residue * modes.mirrored)[:, None] * powers[:, kept], conjugate=True),
        backward_out=_interleaved(modes.residue[:, None] * powers[:, length - 1 - kept], conjugate=True),
        decay=modes.powers(np.array([length]))[:, 0],
    )


def _interleaved(values: ComplexArray, *, conjugate: bool = False) -> FloatArray:
    """(2m, k) real and imaginary parts in turn of `values` (m, k).

    With `conjugate`, a state times them gives the real part of the complex product.
    """
    stacked = np.stack([values.real, -values.imag if conjugate else values.imag], axis=1)
    return np.asarray(stacked.reshape(-1, values.shape[1]))


def modes_of(sos: FloatArray) -> Modes:
    """Partial fractions of a cascade of sections.

    Poles near 1 are computed as their distance from 1, from coefficients that are subtracted exactly: in floating
    point, a cut-off of a thousandth of the rate would cost half of the digits.
    """
    # Odd orders come with as many poles as zeros at 0, not always in the same section; they cancel.
    without_pole, without_zero = np.flatnonzero(sos[:, 5] == 0), np.flatnonzero(sos[:, 2] == 0)
    cancelled = min(len(without_pole), len(without_zero))
    distances: list[complex] = []  # 1 − λ, all poles
    for section, (_, _, _, _, a1, a2) in enumerate(sos.tolist()):
        distances += _pole_distances(a1, a2, first_order=section in without_pole[:cancelled])
    distance = np.array(distances)
    pole = 1 - distance
    numerator = np.ones(len(pole), dtype=np.complex128)
    for section, (b0, b1, b2, _, _, _) in enumerate(sos.tolist()):
        first_order = section in without_zero[:cancelled]
        numerator *= b0 * pole + b1 if first_order else (b0 * pole + b1) * pole + b2
    differences = distance[None, :] - distance[:, None]  # λᵢ − λⱼ
    np.fill_diagonal(differences, 1)
    if np.any(differences == 0):
        raise ValueError("a filter with a repeated pole has no partial fractions of this form")
    residue = numerator / differences.prod(axis=1)
    direct = float(sos[:, 0].prod())
    products = distance[:, None] + distance - distance[:, None] * distance  # 1 − λᵢλⱼ
    mirrored = direct + pole * (residue / products).sum(axis=1)
    center = direct**2 + float((residue[:, None] * residue / products).sum().real)
    upper = pole.imag >= 0
    paired = pole.imag[upper] > 0
    return Modes(
        pole=pole[upper],
        residue=residue[upper] * np.where(paired, 2.0, 1.0),
        mirrored=mirrored[upper],
        paired=paired,
        offset=distance[upper],
        direct=direct,
        center=center,
    )


def _pole_distances(a1: float, a2: float, *, first_order: bool) -> list[complex]:
    """1 − λ for the poles of 1 + a1/z + a2/z²."""
    half = 1 + Fraction(a1) / 2
    if first_order:
        return [complex(1 + Fraction(a1))]
    constant = 1 + Fraction(a1) + Fraction(a2)
    discriminant = half**2 - constant
    root = math.sqrt(abs(discriminant))
    if discriminant < 0:
        return [complex(half, root), complex(half, -root)]
    larger = float(half) + math.copysign(root, half)
    return [complex(larger), complex(float(constant) / larger)]
