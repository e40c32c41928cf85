"""A graded sample batch against its known moduli: order (Kendall's tau) and relative error of every E.

Also whether each fruit has a watertight mesh among the results and stands on the page.

    python benchmarks/sample_answers.py RESULTS ANSWERS.json [--tau 1.0] [--error 0.08]

Exit status 1 where the order or an error misses its bound, or a mesh or a fruit on the page is missing.
"""

import json
import re
from pathlib import Path

import pandas as pd
import trimesh
from scipy.stats import kendalltau
from script import run


def main(results: Path, answers: Path, tau: float = 1.0, error: float = 0.08) -> int:
    """Prints the table; the exit status says whether order, errors, meshes and page are right."""
    ranking = pd.read_csv(results / "ranking.csv", dtype={"fruit_id": str})
    truth = {name: answer["E_MPa"] for name, answer in json.loads(answers.read_text())["fruits"].items()}
    graded = ranking[ranking["E_MPa"].notna()].copy()
    graded["truth_MPa"] = graded["fruit_id"].map(truth)
    graded["error"] = graded["E_MPa"] / graded["truth_MPa"] - 1
    graded["error_over_sd"] = (graded["E_MPa"] - graded["truth_MPa"]) / graded["E_sd_MPa"]
    columns = ["rank", "fruit_id", "E_MPa", "E_sd_MPa", "truth_MPa", "error", "error_over_sd"]
    print(graded[columns].to_string(index=False, float_format=lambda x: f"{x:.4g}"))
    if len(graded) < 2:
        print(f"only {len(graded)} of {len(truth)} fruit graded: no order to score")
        return 1
    order = float(kendalltau(graded["rank"], graded["truth_MPa"]).statistic)
    worst = float(graded["error"].abs().max())
    print(
        f"Kendall's tau {order:.2f}, {len(graded)} of {len(truth)} fruit, largest error {100 * worst:.1f} %"
    )
    missing = missing_results(results, sorted(truth))
    print("\n".join(missing) or "a watertight mesh of each fruit, and each on the page")
    missed = len(graded) < len(truth) or not (order >= tau and worst <= error)
    return int(missed or bool(missing))


def missing_results(results: Path, fruit_ids: list[str]) -> list[str]:
    """What is missing among the results, one sentence each."""
    page = results / "report.html"
    if not page.is_file():
        return [f"no {page}"]
    headings = _fruit_headings(page.read_text(encoding="utf-8"))
    said = [
        f"{fruit}: no heading of its own in {page}"
        for fruit in fruit_ids
        if not any(re.search(rf"\b{re.escape(fruit)}\b", heading) for heading in headings)
    ]
    for fruit in fruit_ids:
        mesh = results / "fruits" / fruit / "fruit.ply"
        if not mesh.is_file():
            said.append(f"{fruit}: no {mesh}")
        elif not trimesh.load_mesh(mesh).is_watertight:
            said.append(f"{fruit}: {mesh} is not watertight")
    return said


def _fruit_headings(page: str) -> list[str]:
    """Heading of each fruit's card. The page holds the cards as lines of JSON and draws one at a time."""
    cards = re.search(r'<script type="application/json" id="details">(.*?)</script>', page, re.DOTALL)
    lines = cards[1].splitlines() if cards else []
    return [
        heading for line in lines for heading in re.findall(r"<h3[^>]*>(.*?)</h3>", json.loads(line)["html"])
    ]


if __name__ == "__main__":
    run(main)
