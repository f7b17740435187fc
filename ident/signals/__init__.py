"""From a recording to gap-free segments of filtered signals on a uniform grid."""
