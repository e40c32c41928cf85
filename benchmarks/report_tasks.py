"""Fifteen tasks of a quality manager on a report, in clicks and keys, and what the report costs a browser.

    python benchmarks/report_tasks.py RESULTS [--multiqc FILE] [--csv FILE]

RESULTS is a folder of `drupe grade` with report.html and ranking.csv. The script performs every task on the
report in headless Chromium and compares the answer with pandas' from ranking.csv. Of a curve and a sheet it
compares the fruit and its E, because ranking.csv has no curve. A click, a drag and a key
count one each (a chord such as Ctrl+C too), a choice from a list two. Reading and scrolling count nothing.
The spreadsheet's numbers are counted, not performed: steps of Excel's menus on ranking.csv as it opens.
Two of MultiQC's are performed, on a report of the columns of ranking.csv as a table, and a search is counted.
A dash means that the program cannot do it.
"""

import io
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from script import run

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "reports"))
from browser import NODES, chromium, reloaded

FILTER = 5
"""Steps to one value of a column: filter on (Ctrl+Shift+L), its arrow, all values off, the value, OK."""
PIVOT = ("Insert", "PivotTable", "OK", "drag maturity to the rows")
SHARES = ("drag maturity to the values", "right click", "Show Values As", "% of Grand Total")
MEAN = ("drag E_MPa to the values", "right click", "Summarize Values By", "Average")
DEVIATION = ("drag E_MPa to the values", "right click", "Summarize Values By", "More Options", "StdDev", "OK")
"""Steps in Excel: a table with a row for each class, and what it shows of them."""
NOT_TRIED = "not tried"

CELLS = """(head) => {
  const has = (one) => one.tHead && one.tHead.innerText.includes(head);
  const table = [...document.querySelectorAll("table")].find(has);
  const at = [...table.tHead.rows[0].cells].findIndex((cell) => cell.innerText.trim() === head);
  return [...table.tBodies[0].rows].map((row) => row.cells[at].innerText.trim());
}"""
"""Texts of a column of a table of MultiQC's, in the order of its rows."""


class Hand:
    """Does what a person does on a page, and counts."""

    def __init__(self, page) -> None:
        self.page, self.count = page, 0

    def click(self, where) -> None:
        """One."""
        where.click()
        self.count += 1

    def type(self, text: str) -> None:
        """One for each character."""
        self.page.keyboard.type(text)
        self.count += len(text)

    def press(self, key: str) -> None:
        """One, a chord too."""
        self.page.keyboard.press(key)
        self.count += 1

    def choose(self, name: str, value: str) -> None:
        """Two: the list, and the value in it."""
        self.page.locator(f"form.tools [name={name}]").select_option(value)
        self.count += 2

    def shown(self) -> list[str]:
        """Fruit of the table in its order, scrolled through."""
        box, names = self.page.locator(".box"), []
        height = box.evaluate("box => box.scrollHeight")
        for top in range(0, height, 300):
            box.evaluate(
                "(box, top) => { box.scrollTop = top; box.dispatchEvent(new Event('scroll')); }", top
            )
            names += self.page.locator("table.fruit tbody tr:not(.space) th").all_inner_texts()
        box.evaluate("box => { box.scrollTop = 0; }")
        return list(dict.fromkeys(names))


def tasks(table: pd.DataFrame):
    """Name, what is done on the report, and whether pandas says the same, of each task."""
    graded = table[table.E_MPa.notna()]
    commonest_class = graded.maturity.mode()[0]
    some, name = graded[graded.maturity == commonest_class], graded.fruit_id.iloc[len(graded) // 2]
    low, high = (f"{x:.1f}" for x in np.quantile(graded.E_MPa, (0.3, 0.6)))
    between = graded[graded.E_MPa.between(float(low), float(high))]
    ship = set(table.fruit_id[table.decision == "ship"])

    def text(hand, where):
        return hand.page.locator(where).first.inner_text().replace("\u00a0", " ")

    def shows(hand, row):
        """The card shows the fruit of this row, with its E."""
        E_MPa = float(re.search(r"E = ([\d.]+)", text(hand, "#card .result"))[1])
        return (
            text(hand, "#fruit-name").endswith(row.fruit_id) and abs(E_MPa - row.E_MPa) < 0.1 * row.E_sd_MPa
        )

    def count(hand):
        return int(text(hand, ".count[data-list=ship]")) == len(ship)

    def shares(hand):
        said = text(hand, ".summary")
        return all(f"{100 * share:.0f} %" in said for share in graded.maturity.value_counts(normalize=True))

    def softest(hand):
        least = graded.loc[graded.E_MPa.idxmin()]
        return least.fruit_id in text(hand, ".verdict") and shows(hand, least)

    def inspect(hand):
        reasons = table.decision_reason[table.decision == "inspect"]
        reasons = reasons.map(lambda reason: reason.partition(":")[0]).value_counts()
        listed = text(hand, ".card.inspect").lower()
        shown = int(text(hand, ".count[data-list=inspect]")) == reasons.sum()
        return shown and all(f"{reason} ({fruit})".lower() in listed for reason, fruit in reasons.items())

    def alone(hand):
        hand.choose("class", commonest_class)
        return hand.shown() == list(some.fruit_id)

    def limits(hand):
        hand.click(hand.page.locator("[name=from]"))
        hand.type(low)
        hand.press("Tab")
        hand.type(high)
        return hand.shown() == list(between.fruit_id)

    def mean(hand):
        hand.choose("class", commonest_class)
        said = text(hand, "form.tools output")
        return f"{some.E_MPa.mean():.3g}" in said and f"{some.E_MPa.std():.3g}" in said

    def find(hand):
        hand.click(hand.page.locator("[name=q]"))
        hand.type(name)
        return hand.shown() == [name]

    def by_height(hand):
        hand.click(hand.page.get_by_role("button", name="Height"))
        heights = table.set_index("fruit_id").height_mm[hand.shown()].dropna()
        return heights.is_monotonic_increasing and len(heights) == table.height_mm.notna().sum()

    def curve(hand):
        hand.click(hand.page.locator("table.fruit tbody th a").nth(1))
        return force(hand) and shows(hand, table.loc[1])

    def force(hand):
        label = hand.page.locator("#card .plot").first.get_attribute("aria-label")
        peaks = re.findall(r"pad \w+: ([\d.]+) N", label)
        return label.startswith("Force against travel") and all(float(peak) > 0 for peak in peaks or ["0"])

    def following(hand):
        hand.click(hand.page.get_by_role("button", name="Next", exact=True))
        return force(hand) and shows(hand, table.loc[1])

    def save(hand):
        hand.choose("list", "ship")
        with hand.page.expect_download() as coming:
            hand.click(hand.page.locator("button.save"))
        saved = pd.read_csv(io.StringIO(coming.value.path().read_text("utf-8-sig")))
        return set(saved.fruit_id) == ship

    def histogram(hand):
        said = hand.page.locator("#histogram .plot").get_attribute("aria-label")
        bars = np.array(re.findall(r"([\d.]+)–([\d.]+) MPa: (\d+)", said), dtype=float)
        for low, high, fruit in bars:  # their ends are rounded
            air = 0.02 * (high - low)
            inside = graded[graded.E_MPa.between(low + air, high - air)]
            if inside.maturity.nunique() > 1 or not (
                len(inside) <= fruit <= graded.E_MPa.between(low - air, high + air).sum()
            ):
                return False
        return bars[:, 2].sum() == len(graded)

    def sheet(hand):
        hand.page.evaluate("window.print = () => { window.sheet = document.body.className; }")
        hand.click(hand.page.locator("table.fruit tbody th a").first)
        hand.click(hand.page.locator("#card button.alone"))
        hand.count += 1  # Print in the dialog of the browser
        hand.page.evaluate("document.body.classList.add(window.sheet)")
        pages = len(re.findall(rb"/Type\s*/Page\b", hand.page.pdf(format="A4")))
        hand.page.emulate_media(media="print")
        return pages == 1 and shows(hand, table.loc[0]) and "Signature" in text(hand, "body")

    def view(hand):
        hand.choose("class", commonest_class)
        hand.press("Control+l")
        hand.press("Control+c")
        address = hand.page.url
        hand.page.goto("about:blank")
        hand.page.goto(address)
        return hand.shown() == list(some.fruit_id)

    return (
        {
            "count the fruit to ship": count,
            "share of each class": shares,
            "the softest fruit and its E": softest,
            "fruit to inspect, with reasons": inspect,
            "show one class alone": alone,
            "fruit with E between two limits": limits,
            "mean and standard deviation of a class": mean,
            "find a fruit by its name": find,
            "sort by height": by_height,
            "force-displacement curve of a fruit": curve,
            "the same of the next fruit": following,
            "save the fruit to ship as CSV": save,
            "histogram of E with the class limits": histogram,
            "print the sheet of a fruit": sheet,
            "hand on exactly this view": view,
        },
        name,
    )


def spreadsheet(name: str) -> list[int | None]:
    """Clicks and keys in a spreadsheet, in the order of the tasks."""
    return [
        FILTER,  # the status bar counts
        len(PIVOT + SHARES),
        0,  # the first row
        FILTER,
        FILTER,
        1 + 3 + 3 + 1 + 3 + 1,  # filter on; arrow, number filters, between; number, Tab, number, Enter
        len(PIVOT + MEAN + DEVIATION),
        1 + len(name) + 1,  # Ctrl+F, name, Enter
        2,  # a cell of the column, sort
        None,
        None,
        FILTER + 2 + 2 + 1 + len("ship.csv") + 2,  # copy all, paste into a new file, save as, name, type
        4,  # the column; insert, histogram, its kind (limits of classes are not drawn)
        None,
        FILTER + 1,  # and save
    ]


def in_multiqc(browser, path: Path, name: str) -> list[int | str]:
    """The same in a report of MultiQC with a table of the ranking's columns: two tasks performed."""
    counts: list[int | str] = [NOT_TRIED] * 15
    for task, head in ((2, "E_MPa"), (8, "height_mm")):
        page = browser.new_page()
        page.goto(path.as_uri())
        hand, values = Hand(page), []
        while not values or values != sorted(values):
            hand.click(page.locator(f"table thead th:has-text('{head}')").first)
            page.wait_for_timeout(500)
            values = [float(text) for text in page.evaluate(CELLS, head) if text]
        counts[task] = hand.count
        page.close()
    counts[7] = 1 + len(name) + 1  # the browser's search, counted
    return counts


def cost(browser, path: Path) -> str:
    """Size of the file, time until it is loaded (the best of three), and nodes of the document."""
    page = browser.new_page()
    page.goto(path.as_uri(), timeout=120_000)
    loads = [reloaded(page) for _ in range(3)]
    nodes = page.evaluate(NODES)
    page.close()
    loaded, processor = (min(each) for each in zip(*loads, strict=True))
    return (
        f"{path.stat().st_size / 1e6:.1f} MB, loaded in {loaded:.2f} s ({processor:.2f} s CPU), {nodes} nodes"
    )


def main(results: Path, multiqc: Path | None = None, csv: Path | None = None) -> None:
    """Prints the cost, and a row for each task."""
    table = pd.read_csv(results / "ranking.csv")
    to_do, name = tasks(table)
    report = (results / "report.html").absolute()
    with chromium() as browser:
        print(f"{len(table)} fruit: {cost(browser, report)}")
        steps = []
        for task, perform in to_do.items():
            page = browser.new_page(accept_downloads=True)
            page.goto(report.as_uri(), timeout=120_000)
            hand = Hand(page)
            if not perform(hand):
                raise SystemExit(f"{task}: the report and pandas disagree")
            steps.append(hand.count)
            page.close()
        others = in_multiqc(browser, multiqc.absolute(), name) if multiqc else [NOT_TRIED] * 15
    columns = {"task": [*to_do], "report": steps, "spreadsheet": spreadsheet(name), "multiqc": others}
    counts = pd.DataFrame(columns, dtype=object).fillna("-")
    print(counts.to_string(index=False))
    if csv:
        counts.to_csv(csv, index=False)


if __name__ == "__main__":
    run(main)
