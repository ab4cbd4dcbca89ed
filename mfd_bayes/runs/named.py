"""What a run has by name: it cannot be changed, and a name that is not there is told all names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

from mfd_bayes.errors import NotThereError

Item = TypeVar("Item")


class Named(Mapping[str, Item]):
    """Items by name, in their order.

    Parameters
    ----------
    what : str
        What one of them is, for messages: "calibrated test".
    items : mapping of str to item
    """

    def __init__(self, what: str, items: Mapping[str, Item]) -> None:
        self._what, self._items = what, dict(items)

    def __getitem__(self, name: str) -> Item:
        """The item of a name.

        Raises
        ------
        NotThereError
            When there is none; it is a KeyError too.
        """
        if not isinstance(name, str) or name not in self._items:
            known = ", ".join(self._items) or "none"
            raise NotThereError(f"the run has no {self._what} {name!r}: there are {known}")
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        """Names, in their order."""
        return iter(self._items)

    def __len__(self) -> int:
        """Number of items."""
        return len(self._items)

    def __repr__(self) -> str:
        """As that of a dict."""
        return repr(self._items)
