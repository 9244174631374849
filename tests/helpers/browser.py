"""A real browser without a screen, and what it asks of any network."""

import json
import os
import shutil
from contextlib import contextmanager

import pytest

BROWSER, DRIVER = (shutil.which(name) for name in ("chromium", "chromedriver"))


@contextmanager
def started_browser():
    """Skips where there is none."""
    if not (BROWSER and DRIVER):
        pytest.skip(
            "chromium and chromedriver are not on this machine (Debian: apt install chromium-driver)"
        )
    webdriver = pytest.importorskip(
        "selenium.webdriver", reason="selenium is not installed (dependency group dev)"
    )
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for argument in ("--headless=new", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    if os.geteuid() == 0:
        options.add_argument("--no-sandbox")  # it cannot be had as root
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(
        options=options, service=webdriver.ChromeService(executable_path=DRIVER)
    )
    try:
        yield driver
    finally:
        driver.quit()


def requested(browser):
    """Addresses that the page has asked for, but for data that it holds itself."""
    messages = [
        json.loads(entry["message"])["message"] for entry in browser.get_log("performance")
    ]
    sent = (
        each["params"]["request"]["url"]
        for each in messages
        if each["method"] == "Network.requestWillBeSent"
    )
    return {address for address in sent if not address.startswith("data:")}
