"""Where the parameters of a result come from, in lines for the comment of an export."""

from __future__ import annotations

import math

from daq.recording.recording import software_versions
from drivers.core.text import percent_text
from ident.assessment.validation import Fit
from ident.result.delivered import Parameters
from ident.result.schema import Result


def origin_lines(result: Result, kind: Parameters) -> tuple[str, ...]:
    """Versions, date of the identification, recordings with their SHA-256, held-out error, verdict.

    The date is that of the identification, and nothing tells when the export was written: the same model gives the
    same files.
    """
    identified, own = result.versions.get("dynid", "unknown"), software_versions()["dynid"]
    writer = "" if own == identified else f", written by dynid {own}"
    recordings = [f"  {use.role}: {use.file}, {use.samples} samples, SHA-256 {use.sha256}" for use in result.recordings]
    return (
        f"Identified {result.created} by dynid {identified}, method {result.method}{writer}.",
        *(["Recordings:", *recordings] if recordings else []),
        _error(held_out(result, kind)),
        f"Verdict: {result.verdict.headline}",
    )


def held_out(result: Result, kind: Parameters) -> Fit | None:
    """The error on held-out data of these parameters."""
    if kind == "consistent":
        return None if result.consistent is None else result.consistent.validation
    return result.validation if kind == "full" else result.essential.validation


def _error(fit: Fit | None) -> str:
    if fit is None or not math.isfinite(fit.relative_error):
        return "Held-out error: not known, no recording was held out."
    joints = ", ".join(percent_text(error) for error in fit.joint_relative_error)
    return f"Held-out error of the torque: {percent_text(fit.relative_error)}; joint by joint {joints}."
