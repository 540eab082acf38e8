"""The page in a real browser: heads are drawn, turn together, change with the controls; tables sort."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reports.load import load
from reports.page import write_page
from tests.reports.browser import NAMES, NO_GRAPHICS, SOFTWARE, Tab, browser, find
from tests.reports.example_study import write_example_study
from tests.reports.page_reader import Meshes, Read
from tests.reports.test_page import content_of

pytestmark = pytest.mark.skipif(
    find() is None, reason=f"no browser to drive on PATH; looked for {', '.join(NAMES)} on a POSIX system"
)
STILL = 'document.getElementById("viewer").dataset.state === "still"'


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    work = tmp_path_factory.mktemp("page")
    studies = load([write_example_study(work / "study", identities=2, draws=1)])
    content: dict[str, Any] = content_of(studies, work)
    return write_page(work / "report.html", content, studies, work)


@pytest.fixture(scope="module")
def started(path: Path) -> Iterator[Tab]:
    with browser(str(find()), *SOFTWARE) as tab:
        tab("Network.emulateNetworkConditions", offline=True, latency=0, downloadThroughput=0, uploadThroughput=0)
        yield tab


@pytest.fixture
def tab(started: Tab, path: Path) -> Tab:
    started.events.clear()
    size = {"width": 1200, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    started("Emulation.setDeviceMetricsOverride", **size)
    started.open(path)
    started.wait(STILL)
    return started


def _pictures(tab: Tab) -> dict[str, str]:
    """By column what its canvas shows."""
    script = 'Array.from(document.querySelectorAll("figure"), f => [f.dataset.column, f.firstChild.toDataURL()])'
    return dict(tab.js(script))


def _captions(tab: Tab) -> dict[str, list[str]]:
    script = (
        'Array.from(document.querySelectorAll("figure"), f => '
        "[f.dataset.column, Array.from(f.lastChild.children, c => c.textContent)])"
    )
    return dict(tab.js(script))


def _set(tab: Tab, part: str, script: str) -> None:
    """Change a control as a user does and wait until the heads stand still."""
    tab.js(f"(() => {{ const control = document.querySelector('[data-part={part}]'); {script} }})()")
    tab.wait(STILL)


def _slide(tab: Tab, stop: int) -> None:
    _set(tab, "expression", f"control.value = {stop}; control.dispatchEvent(new Event('input', {{bubbles: true}}));")


def test_heads_are_drawn_without_a_network_or_a_complaint(tab: Tab, path: Path) -> None:
    assert list(_captions(tab)) == ["source", "truth", "delta", "sumner_popovic", "lbs", "plbs"]
    covered = tab.js("""Array.from(document.querySelectorAll("figure canvas"), canvas => {
        const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
        return pixels.filter((value, i) => i % 4 === 3 && value > 200).length / (canvas.width * canvas.height);
    })""")
    assert min(covered) > 0.3
    assert max(covered) < 0.95
    assert len(set(_pictures(tab).values())) == 6
    assert tab.complaints() == []
    assert [url for url in tab.requests() if not url.startswith("data:")] == [path.resolve().as_uri()]


def test_the_scripts_unpack_what_python_packed(tab: Tab, path: Path) -> None:
    read = Read(path.read_text(encoding="utf-8"))
    (study,) = read.heads["studies"]
    (scene,) = study["scenes"]
    meshes = Meshes(read, study)
    names = '["order", "before"].map(name => array(study[name]).then(summed))'
    shown = tab.js(f"""(async () => {{
        const array = id => unpack(document.getElementById("array-" + id).textContent);
        const study = JSON.parse(document.getElementById("heads").textContent).studies[0];
        const [order, before] = await Promise.all({names});
        const frames = walked(await array({scene["truth"]}), {{ order, before }});
        return frames.map(frame => Array.from(frame));
    }})()""")
    expected = meshes.frames(scene["truth"]) / study["step"]
    np.testing.assert_array_equal(np.reshape(shown, expected.shape), np.rint(expected))


def test_captions_name_people_and_errors(tab: Tab, path: Path) -> None:
    (study,) = Read(path.read_text(encoding="utf-8")).heads["studies"]
    (scene,) = study["scenes"]
    said, stop = _captions(tab), scene["liveliest"]
    assert said["source"][:2] == ["source", "person_00"]
    assert said["truth"][:2] == ["truth", "person_01"]
    result = scene["results"]["5"]["lbs"]
    assert said["lbs"] == ["lbs", f"{result['errors'][stop - 1]} mm", f"all 5: {result['mean']} mm"]
    _set(tab, "counts", "control.querySelector('[value=\"30\"]').click();")
    said = _captions(tab)
    assert said["lbs"][1] == f"{scene['results']['30']['lbs']['errors'][stop - 1]} mm"
    assert said["sumner_popovic"][1] == "no result"


def test_the_error_map_colours_results_alone(tab: Tab) -> None:
    before = _pictures(tab)
    _set(tab, "map", "control.click();")
    after = _pictures(tab)
    assert {name for name in before if before[name] == after[name]} == {"source", "truth"}


def test_the_slider_goes_from_the_neutral_through_the_expressions(tab: Tab) -> None:
    _set(tab, "map", "control.click();")
    seen = []
    for stop in range(6):
        _slide(tab, stop)
        pictures = _pictures(tab)
        assert (pictures["truth"] == pictures["lbs"]) == (stop == 0)
        seen.append(pictures["truth"])
    assert len(set(seen)) == 6
    assert tab.js("document.querySelector('[data-part=name]').textContent") == "expression_004 (5 of 5)"
    _slide(tab, 0)
    assert {caption[1] for caption in list(_captions(tab).values())[2:]} == {"neutral"}


def test_the_unmoved_neutral_looks_the_same_in_every_expression(tab: Tab) -> None:
    _set(tab, "map", "control.click();")
    _set(tab, "methods", "control.querySelector('[value=neutral]').click();")
    pictures = []
    for stop in (0, 3):
        _slide(tab, stop)
        pictures.append(_pictures(tab)["neutral"])
    assert pictures[0] == pictures[1]


@pytest.mark.parametrize("by", ["keys", "mouse"])
def test_all_heads_turn_together_and_reset(tab: Tab, by: str) -> None:
    before = _pictures(tab)
    if by == "keys":
        tab.js("document.querySelectorAll('figure canvas')[2].focus()")
        tab.press("ArrowLeft", 37)
    else:
        box = tab.js("(r => [r.x + r.width / 2, r.y + r.height / 2])"
                     "(document.querySelector('figure canvas').getBoundingClientRect())")  # fmt: skip
        for kind, dx in (("mousePressed", 0), ("mouseMoved", 40), ("mouseReleased", 40)):
            held = {"button": "left", "buttons": 1, "clickCount": 1}
            tab("Input.dispatchMouseEvent", type=kind, x=box[0] + dx, y=box[1], **held)
    tab.js("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    after = _pictures(tab)
    assert all(before[name] != after[name] for name in before)
    _set(tab, "reset", "control.click();")
    assert _pictures(tab) == before


def test_play_goes_on_by_itself_and_stops(tab: Tab) -> None:
    value = "document.querySelector('[data-part=expression]').value"
    first = tab.js(value)
    tab.js("document.querySelector('[data-part=play]').click()")
    tab.wait(f"{value} !== '{first}'")
    assert tab.js("document.querySelector('[data-part=play]').textContent") == "Pause"
    tab.js("document.querySelector('[data-part=play]').click()")
    tab.wait(STILL)


def _column(tab: Tab, column: int) -> list[str]:
    script = f'Array.from(document.querySelector("table").tBodies[0].rows, r => r.cells[{column}].textContent)'
    return list(tab.js(script))


def test_tables_sort_up_down_and_back(tab: Tab) -> None:
    original = _column(tab, 7)
    assert "no result 2 missing" in original
    click = 'document.querySelectorAll("table thead tr:last-child button")[7].click()'
    known = sorted((text for text in original if "no result" not in text), key=float)
    for expected in (known, known[::-1]):
        tab.js(click)
        assert _column(tab, 7) == [*expected, "no result 2 missing"]
    tab.js(click)
    assert _column(tab, 7) == original
    keys = ["−0.1", "< 0.0001", "[0.2, 0.3]", "900 µs", "5 ms", "42 %"]
    assert tab.js(f"{keys}.map(sortKey)") == pytest.approx([-0.1, 1e-4, 0.2, 9e-4, 5e-3, 42])


def test_a_phone_shows_it_without_scrolling_sideways(tab: Tab) -> None:
    tab("Emulation.setDeviceMetricsOverride", width=360, height=740, deviceScaleFactor=2, mobile=True)
    tab.wait("innerWidth === 360")
    assert tab.js("document.documentElement.scrollWidth") == 360
    assert tab.js('document.querySelector("figure canvas").getBoundingClientRect().width') > 120
    assert tab.js('document.querySelector("figure canvas").getBoundingClientRect().bottom') < 740  # a whole head


def test_without_graphics_the_page_says_so_and_the_tables_work(path: Path) -> None:
    with browser(str(find()), *NO_GRAPHICS) as tab:
        tab.open(path)
        tab.wait('document.getElementById("viewer").dataset.state === "failed"')
        assert "no WebGL 2" in tab.js("document.querySelector('[data-part=said]').innerText")
        assert not tab.js("document.querySelector('[data-part=stage]').checkVisibility()")
        tab.js('document.querySelectorAll("table thead tr:last-child button")[1].click()')
        values = [float(text.split(" ")[0]) for text in _column(tab, 1) if "no result" not in text]
        assert values == sorted(values)
        assert not [words for words in tab.complaints() if "exception" in words]
