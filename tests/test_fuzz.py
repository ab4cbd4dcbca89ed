"""Some seeded inputs of benchmarks/fuzz: changed files end in a result or in a sentence."""

import os
import sys
from collections import Counter
from types import ModuleType

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="memory is limited by POSIX")


@pytest.fixture(scope="module")
def study(benchmark_module) -> ModuleType:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads take the memory
    return benchmark_module("fuzz.run")


@pytest.mark.slow
def test_changed_files_end_in_a_result_or_a_sentence(study):
    targets = study.few()
    counts = study.shares(targets, 800)
    run = [count for t, count in zip(targets, counts, strict=True) if t.name.startswith("run: ")]
    assert sum(run) > 0.05 * sum(counts)
    tallies = study.run(study.few, counts, seed=7, jobs=2)
    found = [e for tally in tallies for e in tally.findings]
    assert found == []
    total = sum((tally.kinds for tally in tallies), Counter())
    assert total.total() == sum(counts)
    assert total["result"] > 50  # some changes are harmless
    assert total["refused"] > 500
    for target, tally in zip(targets, tallies, strict=True):
        if target.name in ("run: manifest", "run: manifest, resumed"):
            assert min(tally.kinds["result"], tally.kinds["refused"]) > 0


@pytest.mark.slow
def test_faulty_readers_are_found(study):
    targets = study.controls()
    tallies = study.run(study.controls, [1] * len(targets), seed=1, jobs=2, seconds=3.0)
    words = {t.name: tally.findings[0].words for t, tally in zip(targets, tallies, strict=True)}
    assert "ValueError" in words["raises"]
    assert "KeyError" in words["looks_up"]
    assert "more than 3 s" in words["hangs"]
    assert "exit code -11" in words["dies"]
    assert "MemoryError" in words["fills_memory"]
    assert "elsewhere" in words["writes_elsewhere"]
    assert "pickle.find_class" in words["unpickles"]
    assert "subprocess.Popen" in words["starts"]


def test_an_input_is_made_again_from_its_number(study):
    target = next(t for t in study.targets() if t.name == "csv")
    one, again, other = (study.make_input(target, 1, number)[1] for number in (5, 5, 6))
    assert one == again != other
