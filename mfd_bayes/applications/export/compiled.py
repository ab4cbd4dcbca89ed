"""The step in C: its source with parameter sets, compiled and loaded where a compiler is found."""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.applications.export.c_source import source, table
from mfd_bayes.applications.export.sets import (
    ParameterSets,
    check_model,
    middle_level,
    parameter_sets,
)
from mfd_bayes.errors import FitError, NotThereError, ReportError, real_number, whole_number
from mfd_bayes.runs.run import Run, actuation_level

Array = NDArray[np.float64]

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC")
CODES = {
    -1: "the set's parameters cannot be",
    -2: "dt must be positive, and displacement, velocity and dt finite",
    -3: "the actuation is below 0, or outside of the range of the laws",
    -4: "the force is no finite number at this step",
}
"""What a code of damper.h below 0 says."""


def compiler() -> list[str]:
    """Words that call a compiler of C: that of the variable CC, or the first there is; empty."""
    words = shlex.split(os.environ.get("CC", "")) or [*filter(shutil.which, COMPILERS)][:1]
    return words if words and shutil.which(words[0]) else []


def compile_library(folder: Path, names: Sequence[str], library: Path, *flags: str) -> None:
    """Compile sources of a folder to a shared library; ReportError where that fails."""
    command = [*compiler(), *FLAGS, *flags, *names, "-o", str(library), "-lm"]
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if ended.returncode:
        reason = (ended.stderr.strip().splitlines() or ["it said nothing"])[0]
        raise ReportError(f"the compiler {command[0]} failed on the step in C: {reason}")


class _Memory(ctypes.Structure):
    """`damper_state` of damper.h; what follows `gap_travel` is its memory."""

    _fields_ = (
        ("device", ctypes.c_void_p),
        ("force", ctypes.c_double),
        ("work", ctypes.c_double),
        ("gap_travel", ctypes.c_double),
        ("memory", ctypes.c_double * 16),
    )


@dataclass(frozen=True, eq=False)
class CompiledState:
    """A damper at a sample of its motion; a step makes a new one and leaves this one.

    Attributes
    ----------
    force, work, gap_travel : float, kip, kip*in, in
        Force; work done on the damper since the start; way in its gap since it last slipped.
    tested : bool
        Whether the actuation of the step lies in the tested range.
    """

    force: float
    work: float
    gap_travel: float
    tested: bool
    _memory: _Memory = field(repr=False)


class CompiledStep:
    """The step of a run's model in C, with the parameter sets of its device.

    Attributes
    ----------
    names : tuple of str
        Of the sets: "nominal", "lower", "upper", and the draws "1", "2", ….
    sets : ParameterSets
    """

    def __init__(self, sets: ParameterSets) -> None:
        if not compiler():
            raise ReportError(
                "there is no compiler of C here: none of CC, " + ", ".join(COMPILERS) + " is "
                "found. Install one (apt install gcc), or call run.model.step, which needs none "
                "and gives the same forces"
            )
        self.sets, self.names = sets, sets.names
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for file in ("damper.h", "damper.c", "shared.c"):
                (folder / file).write_text(source(file), encoding="utf-8")
            (folder / "damper_sets.c").write_text(table(sets), encoding="utf-8")
            library = folder / "damper.so"
            compile_library(folder, ("damper.c", "shared.c", "damper_sets.c"), library)
            self._library = ctypes.CDLL(str(library))
        c_double, pointer = ctypes.c_double, ctypes.c_void_p
        self._library.damper_find.restype = pointer
        self._library.damper_size.restype = ctypes.c_size_t
        self._library.damper_state_size.restype = ctypes.c_size_t
        self._library.damper_step.argtypes = (pointer, *(c_double,) * 4)
        self._library.damper_motion.argtypes = (
            *(pointer, ctypes.c_int, ctypes.c_int),
            *(np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS"),) * 5,
        )
        if self._library.damper_state_size() > ctypes.sizeof(_Memory):
            raise ReportError("damper_state of damper.h is larger than this program expects")
        self._devices: dict[str, Any] = {}

    def _device(self, name: str) -> Any:
        """The prepared device of a set."""
        if name not in self._devices:
            if name not in self.names:
                last = self.names[-1]
                raise NotThereError(
                    f"there is no set {name!r}: expected nominal, lower, upper, or the number of "
                    f"a draw, up to {last}"
                )
            device = ctypes.create_string_buffer(self._library.damper_size())
            address = ctypes.c_void_p(self._library.damper_find(name.encode()))
            _check(self._library.damper_prepare(device, address))
            self._devices[name] = device
        return self._devices[name]

    def start(self, name: str | int = "nominal", direction: int = 0) -> CompiledState:
        """State of a set before the first sample of a motion.

        Parameters
        ----------
        name : str or int
            Of the set: one of `names`.
        direction : {0, 1, -1}
            Of the first motion; 0 for that of the first velocity.

        Raises
        ------
        NotThereError
            When there is no set of this name.
        """
        memory = _Memory()
        code = self._library.damper_start(
            ctypes.byref(memory), self._device(str(name)), int(direction)
        )
        if code:
            raise FitError(f"direction must be 0, 1 or -1, got {direction!r}")
        return CompiledState(0.0, 0.0, 0.0, tested=True, _memory=memory)

    def step(
        self,
        state: CompiledState,
        displacement: float,
        velocity: float,
        dt: float,
        actuation: float | None = None,
    ) -> tuple[float, CompiledState]:
        """Force at the next sample of the motion, and the state there, as `Model.step`.

        Parameters
        ----------
        state : CompiledState
            From `start` or the previous step; it is not changed and may be used again.
        displacement, velocity : float, in, in/s
        dt : float, s
            Time since the previous sample; any number at the first, where it does not matter.
        actuation : float, ksi or kip, optional
            Friction follows it by the laws of the set; by default that at which the set stands.

        Returns
        -------
        float, kip, and the new state

        Raises
        ------
        FitError
            When a number is not finite, dt not positive, or the actuation outside of
            `sets.reach`.
        """
        memory = _Memory.from_buffer_copy(state._memory)
        level = self.sets.level if actuation is None else actuation
        code = self._library.damper_step(ctypes.byref(memory), dt, displacement, velocity, level)
        if code < 0:
            _check(code, self.sets)
        force = memory.force
        return force, CompiledState(force, memory.work, memory.gap_travel, code == 0, memory)

    def force(
        self,
        name: str | int,
        time: ArrayLike,
        displacement: ArrayLike,
        velocity: ArrayLike,
        actuation: ArrayLike | None = None,
        direction: int = 0,
    ) -> Array:
        """Force of a set along a motion, (T,), kip, as by `step` at each of its samples.

        `time`, s, `displacement`, in, and `velocity`, in/s, are (T,); the actuation is a number,
        (T,), or that of the sets.
        """
        level = self.sets.level if actuation is None else actuation
        t, x, v, p = (
            np.ascontiguousarray(a, dtype=np.float64)
            for a in np.broadcast_arrays(time, displacement, velocity, level)
        )
        force, dt = np.empty(t.size), np.diff(t, prepend=t[:1])
        device = self._device(str(name))
        _check(
            self._library.damper_motion(device, direction, t.size, dt, x, v, p, force), self.sets
        )
        return force


def _check(code: int, sets: ParameterSets | None = None) -> None:
    """Raise what a code below 0 says."""
    if code >= 0:
        return
    text = CODES.get(code, f"the step failed with the code {code}")
    if code == -3 and sets is not None:
        low, high = sets.reach
        text += f", {low:.4g} to {high:.4g} {sets.unit}"
    raise FitError(text)


def compile_step(
    run: Run, actuation: float | str | None = None, draws: int = 100, seed: int = 1
) -> CompiledStep:
    """The step of a run's model in C, for hybrid simulation: the same results as `Model.step`.

    Parameters
    ----------
    run : Run
    actuation : float, ksi or kip, or str, optional
        Level at which the sets stand, such as "1000 psi"; by default the middle of the tests'.
    draws : int
        Number of draws of "this device tested again" beside the nominal set and its bounds.
    seed : int

    Raises
    ------
    ReportError
        When no compiler of C is found.
    CampaignError
        When the run has a model of its own, which is in Python alone.
    """
    check_model(run, "compile_step")
    whole_number("draws", draws, 1, FitError)
    if actuation is None:
        level = middle_level(run)
    elif isinstance(actuation, str):
        level = actuation_level(run, actuation)
    else:
        level = real_number("actuation", actuation, FitError, (0.0, np.inf))
    return CompiledStep(parameter_sets(run, level, draws, seed))
