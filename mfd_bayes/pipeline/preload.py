"""What the processes of a run need: a module for the server that they are forked from."""

from scipy import stats  # noqa: F401

from mfd_bayes.calibration import sampling  # noqa: F401
from mfd_bayes.reporting import figures, page  # noqa: F401
