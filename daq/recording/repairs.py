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
    DROP_NAN: "drop samples with NaN or infinite values, and quantities without any finite value",
    DROP_DUPLICATES: "keep the first of samples with the same time stamp",
    DROP_REPEATS: "drop samples that repeat the previous one while the arm moves",
    OPPOSITE_TORQUE: "reverse the sign of all torques, currents and voltages",
    SORT: "sort samples that arrived out of order by their time stamp",
    UNWRAP: "continue the stamps of a counter of 16, 31 or 32 bits that overflowed",
}
"""Repairs by name, with what each one does; none is made without a request."""
