"""The page in a real browser: no errors on its console, every picture decoded, nothing asked of any network."""

import base64
import re

import pytest

from tests.helpers.browser import requested

pytestmark = pytest.mark.xdist_group("report")
pytest.importorskip(
    "matplotlib", minversion="3.7", reason="needs the extra report: matplotlib 3.7"
)
WIDTHS = (1600, 420)
"""[px] of a desk's screen and of a telephone's"""


@pytest.fixture
def page(both):
    return both / "report.html"


@pytest.mark.parametrize("width", WIDTHS)
def test_a_browser_shows_all_of_it(browser, page, width):
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get_log("browser"), browser.get_log("performance")  # those of before
    browser.get(page.as_uri())
    assert browser.get_log("browser") == []
    pictures = browser.execute_async_script(
        "const done = arguments[0];"
        "const size = async i => { await i.decode(); return [i.naturalWidth, i.clientWidth]; };"
        "Promise.all([...document.images].map(size))"
        ".then(done, error => done(String(error)));"
    )
    assert isinstance(pictures, list), pictures
    assert len(pictures) == 9
    for natural, shown in pictures:
        assert natural > 800
        assert 300 <= shown <= width
    # Pictures and words fill their rows: no half is blank.
    ends = "[...document.querySelectorAll('.row')].map(row => row.getBoundingClientRect().right -"
    ends += " Math.max(...[...row.children].map(each => each.getBoundingClientRect().right)))"
    assert max(browser.execute_script(f"return {ends}")) < 1.0
    # Tables may be scrolled; the page itself is as wide as the screen.
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    tables = browser.execute_script(
        "return [...document.querySelectorAll('table')].map(t => t.innerText)"
    )
    text = "\n".join(tables)
    for words in ("largest depth", "0.747", "impulse of stance [BW s]"):
        assert words in text
    assert requested(browser) == {page.as_uri()}


def test_it_follows_a_dark_screen_and_prints_on_two_pages(browser, page):
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": dark})
    browser.get(page.as_uri())
    colour = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert max(map(int, re.findall(r"\d+", colour))) < 64
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    pages = re.findall(rb"/Type /Page\b(?!s)", base64.b64decode(printed["data"]))
    assert len(pages) == 2  # of two recordings, each with a comparison
