"""How fast and how exact dynid is, as ratios against its peers in one run: `python -m benchmarks`.

Every side runs with one BLAS thread, ours and the peers' alike: it is what `dynid` sets for itself, and a ratio must
not depend on what else a machine's cores do. The variables must be set before NumPy is first imported, hence here.
"""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_variable] = "1"
