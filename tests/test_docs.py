"""The documentation: its blocks run, its names exist, and the site is built without a warning."""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import traceback
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from typer.main import get_command

import mfd_bayes as mb
from mfd_bayes.applications.buildings.building import read_building
from mfd_bayes.calibration.effort import EFFORTS
from mfd_bayes.campaign import schema
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.cli.commands import app

ROOT = Path(__file__).parents[1]
PAGES = {path.name: path for path in (ROOT / "README.md", *(ROOT / "docs/pages").glob("*.md"))}

# Pages that are read one after the other, and so run in one folder.
SERIES = (
    # calibrates a campaign of its own, and so is slow
    ("lab.md", "report.md", "prediction.md", "building.md", "programs.md", "python.md"),
    ("index.md", "README.md"),  # makes a report of a run, and so is slow
    ("model.md",),
)

# A block whose title says so is not run; the title shows on the page.
NOT_RUN = "not run by the tests"
SCREENSHOTS = {"datasheet.png"}  # made with a browser, by a block of index.md that is not run

STYLE = {"savefig.dpi": 120, "figure.figsize": (6.6, 3.6), "figure.constrained_layout.use": True}
STYLE |= {"axes.spines.top": False, "axes.spines.right": False, "font.size": 9}
STYLE |= {"axes.grid": True, "grid.alpha": 0.3}
"""Of the pictures that Python blocks make."""

BUILT = importlib.util.find_spec("mkdocs") and importlib.util.find_spec("mkdocstrings")
needs_docs = pytest.mark.skipif(not BUILT, reason='needs the extra "docs": pip install ".[docs]"')


@dataclass(frozen=True)
class Block:
    """A fenced block: its page, the line of its first line of code, its language and its code."""

    page: str
    line: int
    language: str
    title: str
    code: str


def blocks_of(page, text):
    blocks = []
    fence = re.compile(r"^```(\w+)(.*?)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    for match in fence.finditer(text):
        line = text.count("\n", 0, match.start(3)) + 1
        blocks.append(Block(page, line, match[1], match[2], match[3]))
    return blocks


def runnable(page):
    blocks = blocks_of(page, PAGES[page].read_text(encoding="utf-8"))
    return [
        b for b in blocks if b.language in ("python", "bash", "text") and NOT_RUN not in b.title
    ]


class Reader:
    """Someone who types in the blocks of a page one after the other."""

    def __init__(self, commands=Path(sys.executable).parent):
        path = [str(commands), str(Path(sys.executable).parent), os.environ["PATH"]]
        self.environment = os.environ | {"PATH": os.pathsep.join(path)}
        self.names, self.said = {"__name__": "__main__"}, ""

    def run(self, block):
        getattr(self, f"run_{block.language}")(block)

    def run_text(self, block):
        """Compare what a page says that the last command printed; … stands for lines left out."""
        printed = {line.rstrip() for line in self.said.splitlines()}
        for number, line in enumerate(block.code.splitlines(), block.line):
            if line.strip() != "…" and line not in printed:
                pytest.fail(f"{block.page}:{number}: not printed: {line}")

    def run_python(self, block):
        code = compile("\n" * (block.line - 1) + block.code, block.page, "exec")
        try:
            exec(code, self.names)
        except BaseException as error:
            frames = traceback.extract_tb(error.__traceback__)
            lines = [frame.lineno for frame in frames if frame.filename == block.page]
            pytest.fail(f"{block.page}:{lines[-1] if lines else block.line}: {error!r}")

    def run_bash(self, block):
        command = ["bash", "-euxo", "pipefail", "-c", block.code]
        how = {"capture_output": True, "text": True, "timeout": 300, "check": False}
        shell = subprocess.run(command, env=self.environment, **how)
        if shell.returncode != 0:
            pytest.fail(f"{block.page}:{block.line}: exit code {shell.returncode}\n{shell.stderr}")
        self.said = shell.stdout


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def commands(without_figures, tmp_path_factory):
    """Folder with the command as installed, but for the figures of its reports."""
    command = tmp_path_factory.mktemp("commands") / "mfd-bayes"
    command.write_text(f'#!/bin/sh\nexec {shlex.join(without_figures)} "$@"\n')
    command.chmod(0o755)
    return command.parent


# ArviZ 0.23 calls Matplotlib in a way that 3.11 deprecates.
@pytest.mark.filterwarnings("ignore:.*alias_mapping:DeprecationWarning")
@pytest.mark.parametrize(
    "pages",
    [*(pytest.param(pages, marks=pytest.mark.slow) for pages in SERIES[:2]), *SERIES[2:]],
    ids=lambda pages: pages[0],
)
def test_the_blocks_of_a_page_run_in_order_and_make_its_pictures(pages, folder, commands, request):
    """Where MFD_BAYES_PICTURES names a folder, such as docs/pages/assets, it gets the pictures."""
    reader = Reader(commands)
    if "index.md" in pages:  # a run of three tests, where the page has one with ten
        shutil.copytree(request.getfixturevalue("finished_run").out, "out")
    for page in pages:
        with plt.rc_context(STYLE):
            for block in runnable(page):
                reader.run(block)
                plt.close("all")
        for name in made_pictures(page):
            picture = folder / name
            assert picture.is_file(), f"{page}: no block makes {name}"
            if target := os.environ.get("MFD_BAYES_PICTURES"):
                shutil.copy(picture, target)


def made_pictures(page):
    """Pictures of a page that its blocks make; docs/sketches.py makes the others."""
    pictures = re.findall(r"\]\(assets/([\w-]+\.png)\)", PAGES[page].read_text(encoding="utf-8"))
    return sorted(set(pictures) - SCREENSHOTS)


def test_every_picture_of_a_page_is_there():
    folder = ROOT / "docs/pages/assets"
    pictures = {name for page in PAGES for name in made_pictures(page)}
    assert {path.name for path in folder.glob("*.png")} == pictures | SCREENSHOTS


@pytest.mark.slow
def test_the_sketches_are_drawn(folder):
    script = ROOT / "docs/sketches.py"
    subprocess.run([sys.executable, script, folder], check=True, timeout=120)
    for name in ("damper.svg", "rooms.svg"):
        assert (folder / name).read_text(encoding="utf-8").count("<path") > 20


def test_every_page_with_blocks_is_run():
    with_blocks = {page for page in PAGES if runnable(page)}
    assert with_blocks == {page for pages in SERIES for page in pages}


def test_a_broken_block_or_words_that_were_not_printed_fail_with_their_line(folder):
    printed = "```bash\necho one\n```\n\n```text\none\n…\nthree\n```\n"
    for text, words in (
        ("```python\nfine = 1\n1 / 0\n```\n", "page.md:3: "),
        ("```bash\ntrue\nfalse\n```\n", "page.md:2: exit code 1"),
        (printed, "page.md:8: not printed: three"),
    ):
        reader = Reader()
        *blocks, broken = blocks_of("page.md", text)
        for block in blocks:
            reader.run(block)
        with pytest.raises(pytest.fail.Exception, match=f"^{words}"):
            reader.run(broken)


def test_the_reference_of_the_campaign_file_has_every_table_and_each_key_a_meaning():
    text = PAGES["campaign.md"].read_text(encoding="utf-8")
    tables = re.findall(r"^\{\{ keys of (\w+) \}\}$", text, re.MULTILINE)
    assert {*schema.CampaignFile.model_fields} <= {*tables}
    for table in tables:
        keys = schema.keys_of(table)
        assert all(default and meaning for default, meaning in keys.values()), table
    assert schema.keys_of("campaign")["noise"][0] == '`"ou"`'
    assert schema.keys_of("test")["file"][0] == "required"
    assert schema.keys_of("laws")["Fy_fwd"][0] == "that of `Fc_fwd`"


@pytest.mark.parametrize("page", ["README.md", "campaign.md"])
def test_campaign_files_that_are_shown_are_accepted(page, tmp_path):
    text = PAGES[page].read_text(encoding="utf-8")
    (block,) = (b for b in blocks_of(page, text) if b.code.startswith("[campaign]"))
    path = tmp_path / "campaign.toml"
    path.write_text(block.code)
    for name in re.findall(r'^file = "(.+?)"', block.code, re.MULTILINE):
        (tmp_path / name).touch()
    assert load_campaign(path).tests


def test_a_building_that_is_shown_has_the_periods_that_are_stated(tmp_path):
    text = PAGES["building.md"].read_text(encoding="utf-8")
    (block,) = (b for b in blocks_of("building.md", text) if '"bench.toml"' in b.title)
    path = tmp_path / "bench.toml"
    path.write_text(block.code)
    building = read_building(path)
    assert building.modes.periods == pytest.approx((0.184, 0.063, 0.042), abs=6e-4)
    assert building.devices


def test_the_targets_of_sampling_are_the_efforts():
    text = PAGES["report.md"].read_text(encoding="utf-8")
    for target in ("r_hat", "ess", "length"):
        stated = " / ".join(f"{getattr(EFFORTS[name], target):g}" for name in EFFORTS)
        assert f"| {stated} |" in text


def test_every_public_name_is_in_the_reference():
    text = PAGES["python.md"].read_text(encoding="utf-8")
    documented = set(re.findall(r"^::: .*\.(\w+)$", text, re.MULTILINE))
    results = {"TestResult", "CompiledStep"}  # what run.tests holds, and compile_step gives
    assert documented - results == set(mb.__all__)


def test_names_commands_and_files_that_are_named_exist():
    for page, path in PAGES.items():
        text = path.read_text(encoding="utf-8")
        names = set(re.findall(r"\bmb\.([A-Za-z_]\w*)", text))
        assert names <= {*mb.__all__, "__all__", "__version__"}, page
        commands = set(re.findall(r"(?:^|`)mfd-bayes ([a-z][a-z-]+)", text, re.MULTILINE))
        assert commands <= set(get_command(app).commands), page
        for target in re.findall(r"\]\(\.\./\.\./([^)]+)\)", text):
            assert (ROOT / target).is_file(), f"{page}: {target}"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    output = tmp_path_factory.mktemp("site")
    words = ["mkdocs", "build", "--strict", "-f", ROOT / "docs/mkdocs.yml", "-d", output]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    how = {"capture_output": True, "text": True, "timeout": 300, "check": False}
    process = subprocess.run([sys.executable, "-m", *words], env=environment, **how)
    assert process.returncode == 0, process.stderr
    return output


@needs_docs
def test_the_site_is_built_and_loads_nothing_from_elsewhere(site):
    pages = {path.with_suffix(".md").name: path.read_text("utf-8") for path in site.glob("*.html")}
    assert pages.keys() >= PAGES.keys() - {"README.md"}
    loads = r'<(?:script|img|iframe|link)\b[^>]*(?:src|href)="(?:https?:)?//[^"]+"'
    for page, html in pages.items():
        assert not re.findall(loads, html), page
    assert pages["model.md"].count("<math") > 30  # formulas are shown without a script
    assert "arithmatex" not in pages["model.md"]
    for command in get_command(app).commands:
        assert f"<code>mfd-bayes {command}</code>" in pages["commands.md"]
