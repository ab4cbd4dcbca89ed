"""The errors that a user can cause, each with one sentence that says what was expected."""


class MfdError(Exception):
    """Base of every error that this package raises on purpose."""


class RecordError(MfdError):
    """A test file cannot be used as it is."""


class CampaignError(MfdError):
    """A campaign file, or a setting, cannot be used as it is."""


class BuildingError(MfdError):
    """A building file, a ground motion, or what is asked of a building, cannot be used as it is."""


class UnitError(MfdError):
    """A unit is unknown, or does not measure what it is used for."""


class PriorError(MfdError):
    """A prior file, or a prior in it, cannot be used as it is."""


class FitError(MfdError):
    """A calibration cannot be started with these data, priors and model."""


class StoreError(MfdError):
    """A run folder, or a file in it, cannot be read or written."""


class ReportError(MfdError):
    """A report cannot be made in the form that was asked for."""


class NotThereError(MfdError, KeyError, IndexError):
    """There is nothing of this name or number; as with a dict or a list, it is a KeyError too."""

    __str__ = Exception.__str__  # a KeyError shows its sentence in quotes
