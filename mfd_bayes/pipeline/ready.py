"""Processes of a run that import what they need while its inputs are read."""

from mfd_bayes.jobs import local


def get_ready() -> None:
    """Let the server of a run's processes start and import what they need."""
    local.get_ready("mfd_bayes.pipeline.loaded")
