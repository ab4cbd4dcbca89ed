"""What the processes of a run need: a module for the server that they are forked from."""

from mfd_bayes.jobs.local import importing

with importing():
    from scipy import stats  # noqa: F401

    from mfd_bayes.calibration import task  # noqa: F401
    from mfd_bayes.reporting import figures, publish  # noqa: F401
    from mfd_bayes.store.arviz import import_arviz

    import_arviz()
