"""The command `next`: what it writes and prints."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from mfd_bayes.applications.next_test.advice import AdviceInWords, next_csv
from mfd_bayes.applications.next_test.next_test import next_test
from mfd_bayes.applications.next_test.options import NextTestOptions
from mfd_bayes.console import print_rows, say, warn
from mfd_bayes.errors import CampaignError, StoreError, why_no_file
from mfd_bayes.runs.folder import ADVICE, alone_in, check_outputs
from mfd_bayes.runs.run import open_run
from mfd_bayes.store.files import commented, json_text, quoted, write_bytes, write_text

_LARGEST = 2**20  # bytes of a file of candidates


def run_next(options: NextTestOptions) -> None:
    """Find which test to make next, and print it; or those that a standard asks for."""
    if options.protocol:
        from mfd_bayes.applications.properties import print_protocol

        run = open_run(options.out, trust=options.trust_model)
        print_protocol(replace(run, units=options.units), options.protocol)
        return
    best, files = write_next(options)
    warn(best.advice.remarks)
    if not options.quiet:
        heads = ["narrows by", "hours", "per hour", "information, nat", "repeats"]
        title = "How much the best candidates are expected to narrow the goal"
        print_rows(title, ["test", *heads], best.shown(10))
    say(best.sentence)
    if not options.quiet:
        for sentence in best.together:
            say(sentence)
        say(f"look next at {' and '.join(map(str, files[:1] + files[2:]))}")


def write_next(options: NextTestOptions) -> tuple[AdviceInWords, list[Path]]:
    """Which test to make next, and the files: the table, its JSON and a picture are written."""
    out = options.out
    if options.tests > 1 and options.draft is None:
        raise CampaignError("--tests says how many tests --write drafts: give --write too")
    table = out / ADVICE[0] if options.table is None else options.table
    if table.suffix.lower() in (".json", ".png"):
        raise StoreError(f"{table} must not end in {table.suffix}: JSON and PNG go beside it")
    files = [table, table.with_suffix(".json"), table.with_suffix(".png")]
    drafts = [] if options.draft is None else [options.draft]
    inputs = [Path(options.candidates)] if _is_path(options.candidates) else []
    own = [] if options.table is None else files  # else they are the run's own
    check_outputs([*own, *drafts], inputs, force=options.force)
    candidates = _candidates(options.candidates)
    run = replace(open_run(out, trust=options.trust_model), units=options.units)
    advice = next_test(
        run,
        options.goal or None,
        candidates,
        limits=options.limits or None,
        draws=options.draws,
        seed=options.seed,
    )
    words = AdviceInWords(advice, run.system, run.actuation_unit)
    if options.table is None:
        with alone_in(out):
            _write_advice(words, files)
    else:
        _write_advice(words, files)
    for draft in drafts:
        write_text(draft, _drafted(words, options.tests))
    return words, [*files, *drafts]


def _candidates(text: str) -> str | list[str] | None:
    """Candidates of a text, or of the lines of a file."""
    path = Path(text)
    if not _is_path(text):
        if path.suffix in (".txt", ".csv", ".toml", ".lst"):
            raise CampaignError(f"--candidates: there is no file {text}")
        return text or None
    if reason := why_no_file(path):
        raise CampaignError(f"--candidates: {path} {reason}")
    try:
        if path.stat().st_size > _LARGEST:
            raise CampaignError(f"--candidates: {path} is larger than 1 MB")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise CampaignError(f"--candidates: cannot read {path}: {error}") from error
    tests = [test for test in (line.partition("#")[0].strip() for line in lines) if test]
    if not tests:
        raise CampaignError(f"--candidates: {path} has no test; one a line is expected")
    return tests


def _is_path(text: str) -> bool:
    """Whether candidates are the name of a file that exists."""
    if not text.strip() or len(text) > 1000 or "|" in text or "\0" in text:
        return False
    try:
        return Path(text).exists()
    except OSError:
        return False


def _write_advice(words: AdviceInWords, files: list[Path]) -> None:
    """Write table, JSON and picture."""
    from mfd_bayes.applications.next_test.advice import draw_next
    from mfd_bayes.reporting.figures import to_png

    write_text(files[0], next_csv(words))
    write_text(files[1], json_text(words.content(), indent=2) + "\n")
    title = f"Next test: {words.candidate(words.advice[0].candidate)}"
    write_bytes(files[2], to_png(draw_next(words.advice, words.system, words.unit, title)))


def _drafted(advice: AdviceInWords, number: int) -> str:
    """Entries of a campaign file for the best tests."""
    sets = advice.advice.together
    together = sets[min(number, len(sets)) - 1]
    tests = (advice.advice[0].candidate,) if number == 1 else together.candidates
    lines = ["# Drafted by mfd-bayes next: add these to campaign.toml once the tests are made."]
    for k, test in enumerate(tests, 1):
        words = advice.candidate(test)
        name = f"next{k}_" + re.sub(r"[^A-Za-z0-9.]+", "_", words)
        lines += [
            "",
            commented(f"motion: {words}, {test.cycles:g} cycles ({test.waveform})"),
            "[[test]]",
            f"id = {quoted(name)}",
            f"file = {quoted(f'{name}.csv')}  # the record, once it is there",
            f"actuation = {quoted(words.split(',', maxsplit=1)[0])}",
            'role = "calibrate"',
        ]
        if test.device:
            lines.append(f"device = {quoted(test.device)}  # its name")
    return "\n".join(lines) + "\n"
