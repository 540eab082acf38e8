"""What a process used of the machine's memory."""

from __future__ import annotations

import sys
import warnings


def peak_memory_mb() -> float:
    """Highest resident memory of this process so far, in MB; NaN-free: 0 where the platform does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        warnings.warn("peak memory is not measured on this platform", stacklevel=2)
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
