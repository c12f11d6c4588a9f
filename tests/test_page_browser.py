"""Pages in a browser: hair is on the canvas, and what people do to it changes it, without a network."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from chromium import Chromium
from detangled.head import Head
from detangled.view.page import Shown, page, save
from detangled_cli.label_summary import summary
from test_page import some_labels, tuft

WIDTH, HEIGHT, PANEL = 900, 600, 340
STAGE = WIDTH - PANEL
FINISHED = "['ready', 'failed'].includes(document.documentElement.dataset.state)"


def settled(browser: Chromium) -> np.ndarray:
    """The picture of the hair, (HEIGHT, STAGE, 3), once the page has finished drawing."""
    browser.wait_for(FINISHED)
    assert browser.evaluate("document.documentElement.dataset.state") == "ready", browser.complaints()
    return browser.picture()[:, :STAGE].astype(int)


def hair_in(picture: np.ndarray) -> np.ndarray:
    """Where it is darker than the background, (HEIGHT, STAGE): the divider and the names are lighter."""
    return picture.max(axis=2) < picture[:, :4].min(axis=(1, 2))[:, None] - 25


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of one and the same groom before and after, with other labels."""
    path = tmp_path_factory.mktemp("page") / "pair.html"
    both = (("before.abc", some_labels(40)), ("after.abc", some_labels(40, seed=6)))
    save(page([Shown(tuft(), name, labels, summary(labels)) for name, labels in both]), path)
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with Chromium(tmp_path_factory.mktemp("profile"), (WIDTH, HEIGHT)) as made:
        yield made


@pytest.fixture
def opened(browser: Chromium, pair: Path) -> Iterator[Chromium]:
    """The page, fresh; nothing may be asked for or complained of, whatever is done to it."""
    browser.resize((WIDTH, HEIGHT))
    browser.events.clear()
    browser.open(pair)
    browser.wait_for(FINISHED)
    yield browser
    assert browser.requests() == [pair.resolve().as_uri()]
    assert browser.complaints() == []


def wipe_to(browser: Chromium, percent: int) -> None:
    at = float(browser.evaluate("document.querySelector('#wipe').ariaValueNow")) / 100 * STAGE
    browser.drag((at, HEIGHT / 2), (percent / 100 * STAGE, HEIGHT / 2))
    assert abs(int(browser.evaluate("document.querySelector('#wipe').ariaValueNow")) - percent) <= 1


def test_hair_is_on_the_canvas_on_both_sides_of_a_divider_that_moves(opened: Chromium) -> None:
    both = settled(opened)
    hair = hair_in(both)
    assert hair[:, : STAGE // 2 - 25].mean() > 0.03
    assert hair[:, STAGE // 2 + 25 :].mean() > 0.03
    # Framed: it reaches near two opposite edges of the picture, and touches none.
    rows, columns = np.flatnonzero(hair.any(axis=1)), np.flatnonzero(hair.any(axis=0))
    assert min(rows[0], HEIGHT - rows[-1], columns[0], STAGE - columns[-1]) > 10
    assert max(np.ptp(rows) / HEIGHT, np.ptp(columns) / STAGE) > 0.8

    columns = np.arange(STAGE)
    clear = (np.abs(columns - STAGE // 2) > 25) & (np.abs(columns - 0.9 * STAGE) > 25)
    between = clear & (columns > STAGE // 2) & (columns < 0.9 * STAGE)
    wipe_to(opened, 90)
    wiped = settled(opened)
    assert np.abs(wiped - both)[:, STAGE // 2 - 2 : STAGE // 2 + 2].max() > 10  # where the divider was
    # It is the same groom, seen alike: only the divider is elsewhere, and the names above.
    np.testing.assert_array_equal(wiped[60:, clear], both[60:, clear])

    opened.evaluate("document.querySelector('[data-value=type]').click()")
    wiped = settled(opened)
    wipe_to(opened, 50)
    both = settled(opened)
    # Its labels are others: between the divider's two places they show.
    changed = (np.abs(wiped - both).max(axis=2) > 20) & hair_in(both)
    assert changed[60:, between].sum() > 0.3 * hair_in(both)[60:, between].sum()
    assert not changed[60:, clear & ~between].any()


def test_a_drag_turns_the_hair_and_a_key_brings_it_back(opened: Chromium) -> None:
    at_first = settled(opened)
    opened.drag((100, 400), (220, 420))
    turned = settled(opened)
    assert np.mean(np.abs(turned - at_first)[hair_in(at_first) | hair_in(turned)] > 10) > 0.3
    opened.press("1")
    inside = np.s_[8:-8, 8:-8]  # of the ring around what has the keyboard's focus
    np.testing.assert_array_equal(settled(opened)[inside], at_first[inside])
    opened.evaluate("document.querySelector('#hair').focus()")
    opened.press("ArrowLeft")
    assert np.abs(settled(opened) - at_first)[inside].max() > 50


def test_width_and_colours_are_what_the_controls_say(opened: Chromium) -> None:
    thin = hair_in(settled(opened)).mean()
    told = opened.evaluate("document.querySelector('#width-value').textContent")
    opened.evaluate("(w => { w.value = 1; w.dispatchEvent(new Event('input')); })(document.querySelector('#width'))")
    wide = hair_in(settled(opened)).mean()
    assert wide > 1.3 * thin
    doubled = opened.evaluate("document.querySelector('#width-value').textContent")
    assert float(doubled.split()[0]) == pytest.approx(2 * float(told.split()[0]), rel=0.1)
    brown = settled(opened)
    opened.evaluate("document.querySelector('[data-value=Copper]').click()")
    copper = settled(opened)
    both = hair_in(brown) & hair_in(copper)
    redder = (copper[..., 0] - copper[..., 2])[both].mean() - (brown[..., 0] - brown[..., 2])[both].mean()
    assert redder > 30


def test_strands_are_coloured_and_hidden_by_their_labels(opened: Chromium) -> None:
    opened.evaluate("document.querySelector('[data-value=type]').click()")
    shown = settled(opened)
    dots = opened.evaluate("[...document.querySelectorAll('.chip')].map(chip => chip.textContent)")
    kinds = np.concatenate([some_labels(40).kind, some_labels(40, seed=6).kind])
    names = np.array(["I", "II", "III", "IV", "V", "VI", "VII", "VIII", "not read"])
    assert dots == list(names[np.unique(np.where(kinds < 0, 8, kinds))])
    opened.evaluate("document.querySelectorAll('.chip').forEach((chip, k) => k && chip.click())")
    few = settled(opened)
    assert 0 < hair_in(few).sum() < 0.5 * hair_in(shown).sum()
    for name in ("radius", "wavelength", "twist"):
        opened.evaluate(f"document.querySelector('[data-value={name}]').click()")
        assert hair_in(settled(opened)).sum() > 0.5 * hair_in(shown).sum()
        assert opened.evaluate("document.querySelectorAll('.ends span').length") == 3


def test_a_strand_that_is_clicked_says_what_it_is(opened: Chromium) -> None:
    rows, columns = np.nonzero(hair_in(settled(opened))[:, : STAGE // 2 - 40])
    opened.click((float(columns[len(columns) // 2]), float(rows[len(rows) // 2])))
    settled(opened)
    said = opened.evaluate("document.querySelector('#picked').textContent")
    index = int(said.split(" · ")[0].removeprefix("strand "))
    labels = some_labels(40)
    told = float(re.search(r"([\d.]+) cm long", said)[1])
    assert told == pytest.approx(tuft().polyline_lengths()[index], rel=0.01)
    assert f"radius {labels.radius[index]:.2f} cm" in said or labels.kind[index] < 0
    opened.press("Escape")
    assert opened.evaluate("document.querySelector('#picked').hidden")


def test_what_the_hair_is_stands_beside_it(opened: Chromium) -> None:
    text = opened.evaluate("document.querySelector('#facts').innerText")
    facts = summary(some_labels(40))
    assert facts["called"] in text
    assert f"{facts['radius_cm']['median']:.2f}" in text
    assert opened.evaluate("document.title") == "before.abc and after.abc"


def test_it_fits_a_phone(opened: Chromium) -> None:
    opened.resize((390, 780), mobile=True)
    opened.wait_for("document.querySelector('#hair').clientWidth === 390")
    # The canvas follows in a frame of its own: until then the page is as ready as it was.
    opened.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")
    opened.wait_for(FINISHED)
    assert opened.evaluate("document.documentElement.scrollWidth") == 390
    assert opened.evaluate("document.querySelector('#panel').scrollHeight") > 300
    drawn = opened.picture()[: 2 * 460].astype(int)
    assert hair_in(drawn).mean() > 0.03


def test_a_head_is_shown_and_hidden(browser: Chromium, tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(3, radius=4.0)
    save(page([Shown(tuft(), "tuft")], Head(ball.vertices, ball.faces)), tmp_path / "head.html")
    browser.events.clear()
    browser.resize((WIDTH, HEIGHT))
    browser.open(tmp_path / "head.html")
    with_head = settled(browser)
    browser.evaluate("document.querySelector('#head').click()")
    without = settled(browser)
    changed = np.abs(with_head - without).max(axis=2) > 10
    assert 0.1 < changed.mean() < 0.7
    assert np.ptp(with_head, axis=2)[changed].mean() < np.ptp(without, axis=2)[hair_in(without)].mean()  # it is grey
    assert browser.complaints() == []


def test_a_damaged_page_says_so(browser: Chromium, tmp_path: Path) -> None:
    text = page([Shown(replace(tuft(), attributes={}), "tuft")]).text
    start = text.index('id="s0">') + len('id="s0">')
    (tmp_path / "damaged.html").write_text(text[:start] + "AAAA" + text[start + 4 :], encoding="utf-8")
    browser.open(tmp_path / "damaged.html")
    browser.wait_for(FINISHED)
    assert browser.evaluate("document.documentElement.dataset.state") == "failed"
    assert browser.evaluate("document.querySelector('#message').textContent.length") > 10
