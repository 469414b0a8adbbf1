# SPDX-License-Identifier: MIT OR Apache-2.0

"""Checks a page of `rsrectify show --html` in Chromium: see scripts/check-page."""

import argparse
import json
import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.wait import WebDriverWait

# Widths and heights of a phone and of a desktop.
SIZES = {360: 740, 1200: 900}
# Notes the frame that each video shows, and how far apart they are at most while both play.
WATCH = """
window.shown = {};
window.apart = [];
for (const id of ["before", "after"]) {
  const video = document.getElementById(id);
  const note = (now, frame) => {
    shown[id] = frame.mediaTime;
    video.requestVideoFrameCallback(note);
  };
  video.requestVideoFrameCallback(note);
}
setInterval(() => {
  const [one, other] = ["before", "after"].map(id => document.getElementById(id));
  if (!one.paused && !other.paused && "before" in shown && "after" in shown) apart.push(Math.abs(shown.before - shown.after));
}, 20);
"""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("page", type=Path)
    parser.add_argument("--screenshots", type=Path)
    options = parser.parse_args()
    driver = browser()
    try:
        check(driver, options.page.resolve(), options.screenshots)
    finally:
        driver.quit()


def browser() -> webdriver.Chrome:
    options = webdriver.ChromeOptions()
    for argument in ("--headless=new", "--mute-audio", "--host-resolver-rules=MAP * ~NOTFOUND", "--hide-scrollbars"):
        options.add_argument(argument)
    if os.geteuid() == 0:
        # Chromium's sandbox refuses root.
        options.add_argument("--no-sandbox")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options=options, service=webdriver.chrome.service.Service("chromedriver"))


def check(driver: webdriver.Chrome, page: Path, screenshots: Path | None) -> None:
    driver.get(page.as_uri())
    wait = WebDriverWait(driver, 30)

    def value(script: str) -> Any:
        return driver.execute_script(f"return {script}")

    def both(field: str) -> list[Any]:
        values: list[Any] = value(f"['before', 'after'].map(id => document.getElementById(id).{field})")
        return values

    wait.until(lambda _: all(state >= 2 for state in both("readyState")))
    data = json.loads(value("document.getElementById('data').textContent"))
    period, times = data["period"], data["times"]
    assert value("document.querySelector('h1').textContent") == data["name"]
    assert len(data["panels"]) == len(driver.find_elements(By.CSS_SELECTOR, "figure")) == 5
    assert both("videoWidth")[0] == both("videoWidth")[1] > 0
    assert times[-1] > 1, "the clip must last for a second, or nothing is seen of playing"
    # The first frame is at time 0; how long the last one lasts is up to the clip.
    for length in both("duration"):
        assert times[-1] - 0.002 < length < times[-1] + 3 * period, (length, times[-1], period)

    # The divider, by pointer and by keyboard.
    split = driver.find_element(By.ID, "split")
    stage = driver.find_element(By.CSS_SELECTOR, ".stage")
    clipped = "getComputedStyle(document.getElementById('after')).clipPath"

    def at() -> float:
        share = re.search(r"([\d.]+)%", value(clipped))
        assert share, value(clipped)
        return float(share[1])

    assert abs(at() - 50) < 0.5, at()
    ActionChains(driver).move_to_element_with_offset(split, int(-0.3 * stage.size["width"]), 20).click().perform()
    assert abs(at() - 20) < 1.5, at()
    split.send_keys(Keys.END)
    assert at() == 100, at()
    split.send_keys(Keys.HOME)
    driver.execute_script("arguments[0].value = 50; arguments[0].dispatchEvent(new Event('input'))", split)
    assert abs(at() - 50) < 0.5, at()

    # Playing, pausing.
    driver.execute_script(WATCH)
    play = driver.find_element(By.ID, "play")
    play.click()
    time.sleep(min(3.0, 0.6 * times[-1]))
    apart = value("apart")
    play.click()
    wait.until(lambda _: all(both("paused")))
    wait.until(lambda _: not any(both("seeking")))
    assert len(apart) > 10, "they do not play"
    # Both have come to play when a third is over. A machine that is busy may be late with single frames.
    settled = sorted(apart[len(apart) // 3 :])
    most = settled[int(0.95 * (len(settled) - 1))]
    assert most < 1.01 * period and settled[-1] < 3.01 * period, f"{most} s apart, once {settled[-1]} s"
    now = both("currentTime")
    assert now[0] > 0.1 * times[-1] and abs(now[0] - now[1]) < 0.1 * period, now

    # Going to a time, by the slider, by a figure, and by frames.
    def settle() -> list[Any]:
        wait.until(lambda _: not any(both("seeking")))
        return both("currentTime")

    for share in (0.75, 0.1):
        driver.execute_script(
            "const seek = document.getElementById('seek'); seek.value = arguments[0] * seek.max; seek.dispatchEvent(new Event('input'))",
            share,
        )
        now = settle()
        assert abs(now[0] - share * times[-1]) < period and abs(now[0] - now[1]) < 0.1 * period, now
    plot = driver.find_element(By.CSS_SELECTOR, ".plot")
    driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
    ActionChains(driver).move_to_element(plot).click().perform()
    now = settle()
    assert abs(now[0] - 0.5 * times[-1]) < 2 * period and abs(now[0] - now[1]) < 0.1 * period, now
    head = value("parseFloat(document.querySelector('.plot div').style.left)")
    assert abs(head - 50) < 2, head

    def frame() -> int:
        return int(value("document.getElementById('clock').textContent").rsplit(" ", 1)[1])

    before = frame()
    driver.find_element(By.ID, "forth").click()
    now = settle()
    assert frame() == before + 1 and abs(now[0] - now[1]) < 0.1 * period, (before, frame(), now)

    # To the end, and again from the start.
    driver.execute_script("goTo(arguments[0])", max(times[-1] - 3 * period, 0))
    play.click()
    wait.until(lambda _: all(both("paused")) and before_end(both, times, period))
    play.click()
    wait.until(lambda _: both("currentTime")[0] < 0.5 * times[-1])
    play.click()

    for width, height in SIZES.items():
        for scheme in ("light", "dark"):
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            features = [{"name": "prefers-color-scheme", "value": scheme}]
            driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
            assert value("document.documentElement.scrollWidth") <= width, f"wider than {width} px"
            dark = value("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
            assert dark == (scheme == "dark")
            if screenshots:
                whole = value("document.documentElement.scrollHeight")
                driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size | {"height": whole})
                driver.execute_script("scrollTo(0, 0)")
                driver.save_screenshot(str(screenshots / f"{Path(data['name']).stem}-{width}-{scheme}.png"))

    errors = [entry for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]
    assert not errors, errors
    messages = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    requests = [one["params"]["request"]["url"] for one in messages if one["method"] == "Network.requestWillBeSent"]
    elsewhere = [url for url in requests if not url.startswith((page.parent.as_uri(), "data:"))]
    assert requests and not elsewhere, elsewhere
    print(f"{data['name']}: {most / period:.2f} frames apart while playing, once {settled[-1] / period:.2f}, {len(requests)} requests, all of the folder")


def before_end(both: Callable[[str], list[Any]], times: list[float], period: float) -> bool:
    return bool(both("currentTime")[0] > times[-1] - period)


if __name__ == "__main__":
    main()
