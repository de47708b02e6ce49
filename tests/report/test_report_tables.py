"""In a real browser: every table copied, saved and sorted, the verdict's links, paper, and the page that compares."""

import base64
import csv

import pytest

from browser import LAPTOP, PHONE, needs_browser
from haptid.report import write_comparison
from haptid.results.result import Result
from reported import found, made

pytestmark = needs_browser
TABLES = "[...document.querySelectorAll('main table')]"
FOLDED = "document.querySelectorAll('details:not([open], .screen)').length"
WIDTHS = "[...document.querySelectorAll('#torque svg.drawing')].map((s) => s.getAttribute('width'))"


@pytest.fixture
def report(tab, folder):
    made().write(folder)
    tab.open(folder / "report.html", LAPTOP)
    return tab


def test_every_table_can_be_sorted_copied_and_saved(report):
    names = report.ask(f"{TABLES}.map((t) => t.id)")
    assert {"parameter-table", "error-table", "finding-table", "log-table"} <= set(names)
    assert all(names)
    assert report.ask(f"{TABLES}.every((t) => [...t.tHead.rows[0].cells].every((h) => h.querySelector('.sort')))")
    bar = "t.closest('.wide').nextElementSibling"
    assert report.ask(f"{TABLES}.every((t) => {bar}.querySelector('[data-copy-table]'))")
    assert report.ask(f"{TABLES}.every((t) => {bar}.querySelector('[data-download=csv]'))")
    assert report.troubles == []


def test_a_saved_table_has_a_line_for_each_row(report):
    report.ask("""
        window.saved = [];
        const whole = URL.createObjectURL;
        URL.createObjectURL = (blob) => { blob.text().then((text) => window.saved.push(text)); return whole(blob); };
        HTMLAnchorElement.prototype.click = function () {};
        document.querySelector('#error-table').closest('.wide').nextElementSibling
            .querySelector('[data-download=csv]').click();
    """)
    report.wait("window.saved.length === 1")
    lines = report.ask("window.saved")[0].splitlines()
    assert lines[0].startswith('log,rows,"all, %"')
    assert [row[1] for row in csv.reader(lines[1:])] == ["of the fit", "unseen", "unseen, moving"]


def test_a_table_wider_than_the_phone_says_so(tab, folder):
    made().write(folder)
    tab.open(folder / "report.html", PHONE)
    tab.wait("!document.querySelector('#parameters .hint').hidden")
    tab.size(2000, 900)
    tab.wait("document.querySelector('#errors .hint').hidden")


def test_a_link_to_a_look_unfolds_it(report):
    looks = report.ask("[...document.querySelectorAll('#finding-table tbody tr')].map((r) => r.id)")
    assert "look-time-delay" in looks
    links = report.ask("[...document.querySelectorAll('#verdict a')].map((a) => a.hash.slice(1))")
    assert set(links) <= set(looks)
    report.ask("document.querySelectorAll('#verdict a').forEach((a) => a.click())")
    assert report.ask("document.querySelector('#finding-table').closest('details').open") == bool(links)


def test_paper_has_one_width_and_everything_unfolded_and_the_window_is_as_before(tab, folder):
    made().write(folder)
    printed = []
    for width in (LAPTOP, PHONE):
        tab.open(folder / "report.html", width)
        before = tab.ask(f"[{FOLDED}, {WIDTHS}]")
        assert before[0] > 0
        tab.ask("window.dispatchEvent(new Event('beforeprint'))")
        assert tab.ask(FOLDED) == 0
        printed.append(tab.ask(WIDTHS))
        tab.ask("window.dispatchEvent(new Event('afterprint'))")
        assert tab.ask(f"[{FOLDED}, {WIDTHS}]") == before
    assert printed[0] == printed[1]
    pdf = tab.call("Page.printToPDF", printBackground=True)["data"]
    (folder / "report.pdf").write_bytes(base64.b64decode(pdf))
    assert tab.troubles == []


def test_a_comparison_opens_with_its_verdict(tab, folder):
    for name in ("monday", "tuesday"):
        (folder / name).mkdir()
        Result.of(found()).save(folder / name)
    section = write_comparison([folder / "monday", folder / "tuesday"], folder / "comparison.html")
    tab.open(folder / "comparison.html", LAPTOP)
    assert tab.troubles == []
    first = tab.ask("document.querySelector('#comparison h2').nextElementSibling.textContent")
    assert first == section.sentences[0]
    assert first.startswith("tuesday compared with monday: 0 of 14 parameters differ (95 % joint confidence")
    assert tab.ask("document.querySelector('#changes svg *') !== null")
    tab.picture(folder / "comparison.png", "body")


def test_an_axis_has_two_numbers_or_more(report):
    counts = report.ask("""
        [...document.querySelectorAll('.chart svg .axes')].map((axes) => {
            const level = [...axes.querySelectorAll('text[text-anchor=middle]:not(.label)')];
            return level.length;
        }).filter((count) => count > 0)
    """)
    assert min(counts) >= 2
