"""Repairs of recorded samples, by the names that `dynid import --repair` takes."""

from __future__ import annotations

from collections.abc import Mapping

DROP_NAN = "drop-nan"
DROP_DUPLICATES = "drop-duplicates"
DROP_REPEATS = "drop-repeats"
OPPOSITE_TORQUE = "opposite-torque"
SORT = "sort"
UNWRAP = "unwrap"
REPAIRS: Mapping[str, str] = {
    DROP_NAN: "leave out samples with NaN or infinite values, and quantities that have no finite value at all",
    DROP_DUPLICATES: "of samples with the same time stamp keep the first",
    DROP_REPEATS: "leave out samples that repeat the one before while the arm moves",
    OPPOSITE_TORQUE: "change the sign of all torques, currents and voltages",
    SORT: "sort samples that arrived out of order by their time stamp",
    UNWRAP: "let stamps of a counter of 16, 31 or 32 bits that began anew go on",
}
"""Repairs by name, with what each one does; none is made without a request."""
