"""The options of the commands `draws`, `export` and `serve`; each docstring is a help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

from mfd_bayes.options import Folder, Replace, RunFolder, Seed, TrustModel, Units, path


@dataclass(frozen=True)
class DrawsOptions:
    """Write the posterior draws of every test as one table, for other programs.

    Writes OUT/draws.csv or OUT/draws.parquet: test, chain and draw, then a column
    for each quantity with its unit in brackets, then the log densities.

    Example:
      mfd-bayes draws out --to csv
      mfd-bayes draws out --to parquet --units si
    """

    out: RunFolder
    to: Annotated[Literal["csv", "parquet"], Option(help="Parquet needs the extra parquet.")]
    units: Units = ""
    most: Annotated[int, Option(min=0, help="Most draws kept of each test; 0 for all.")] = 0
    trust_model: TrustModel = False


@dataclass(frozen=True)
class ExportOptions:
    """Write joint samples of a new device's parameters, or its step, for other programs.

    quofem: a column per variable without a header, grouped so that correlations are
    kept, and dakotaTab.out. opensees: a material fitted to predicted loops, with its
    misfit. csv: one table with names and units. All are in kip, in and ksi, those of a
    model of your own in its units, which about.json has. c: the step of the model in
    C99 with parameter sets (nominal, lower and upper bound, draws) and a self-test.
    fmu: the same as an FMU for co-simulation, in SI units, with sources inside.
    Outside of the tested actuations it warns, far outside it refuses.

    Example:
      mfd-bayes export out --to quofem --actuation "1000 psi" -o samples
      mfd-bayes export out --to c -o damper
      mfd-bayes export out --to fmu --fmi 3.0 -o damper.fmu
    """

    out: RunFolder
    to: Annotated[
        Literal["quofem", "opensees", "csv", "c", "fmu"], Option(help="Who is to read it.")
    ]
    folder: Folder = Path("export")
    actuation: Annotated[
        str, Option(help='Such as "1000 psi"; the middle of the tests\' by default.')
    ] = ""
    draws: Annotated[
        int | None, Option(min=10, max=20000, help="1000 by default; of a step 100.")
    ] = None
    seed: Seed = 1
    fmi: Annotated[Literal["2.0", "3.0"], Option(help="Version of the standard of an FMU.")] = "2.0"
    force: Replace = False
    extrapolate: Annotated[
        bool, Option("--extrapolate", help="Export also far outside of the tested range.")
    ] = False
    trust_model: TrustModel = False


@dataclass(frozen=True)
class ServeOptions:
    """Serve a model, or a run's log posterior, to other programs, as UM-Bridge has it.

    Any program for uncertainty quantification that speaks this protocol over HTTP
    can call it, on this machine. OUT serves "posterior": sampled coordinates in,
    log density out; "values": their parameters; and "forward": parameters in, force
    of the test's motion out. A model serves "forward" for a motion that you give.
    Names and units are printed. Writes nothing; a model in a file is run.

    Example:
      mfd-bayes serve out --port 4242
      mfd-bayes serve lugre --sine "1 in, 0.5 Hz, 3 cycles"
      mfd-bayes serve my_damper.py:Viscous --motion quake.csv --actuation "1 ksi"
    """

    source: Annotated[
        str, Argument(metavar="MODEL|OUT", help="A model, as in a campaign file, or a run folder.")
    ]
    port: Annotated[int, Option(min=0, max=65535, help="0 for any that is free.")] = 4242
    motion: Annotated[
        Path | None, Option(parser=path, help="A model's motion: a file, or --sine.")
    ] = None
    sine: Annotated[str, Option(help='Such as "1 in, 0.5 Hz, 3 cycles".')] = ""
    actuation: Annotated[str, Option(help='Of a model, such as "1000 psi".')] = ""
    trust_model: TrustModel = False
