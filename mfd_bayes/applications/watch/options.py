"""The options of the command `watch`; the docstring is its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mfd_bayes.options import Cycles, Date, Temperature, TrustModel, path


@dataclass(frozen=True)
class WatchOptions:
    """Follow a test while it runs: a line for each cycle, and when the test is long enough.

    Prints and writes no file. Each line has the slip forces and the gap of this
    test, with intervals of 95 % and their place among new tests of the run's
    device, and by how much one more cycle would narrow the interval of the
    device's property. What tests of one device scatter stays, however long a test
    is: a test is long enough when one more cycle would narrow no interval by 2 %.

    Example:
      mfd-bayes watch record.csv --run out --actuation "1000 psi"
    """

    record: Annotated[Path, Argument(parser=path, help="The file of the test; it may still grow.")]
    run: Annotated[
        Path, Option("--run", metavar="OUT", parser=path, help="The run of this device.")
    ]
    actuation: Annotated[str, Option(help='Such as "1000 psi".')] = ""
    session: Annotated[str, Option(help="Of the test, where the campaign has sessions.")] = ""
    device: Annotated[str, Option(help="A device of the campaign; else a new one.")] = ""
    date: Date = ""
    cycles: Cycles = None
    temperature: Temperature = ""
    narrowing: Annotated[
        str, Option(metavar='"2 %"', help="Enough where one more cycle narrows no interval so far.")
    ] = "2 %"
    wait: Annotated[
        str, Option(metavar='"10 s"', help="End when the file has not grown for so long.")
    ] = "10 s"
    trust_model: TrustModel = False
