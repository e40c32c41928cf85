"""The page of a history with all its parts, in each language: no English sentence is left in it."""

import html
import re
from datetime import UTC, date, datetime, timedelta

import numpy as np
import pytest
from graded_results import graded, results_of

from pipeline.history.keeping import HistoryWanted, make_history
from pipeline.history.lot_acceptance import PlanWanted
from pipeline.history.lot_quality import QualityWanted
from reports.grasp_record import GraspRecord
from reports.language import LANGUAGES

CLASSES = {
    "classes": [
        {"name": "klass-1", "E_max_MPa": 0.5},
        {"name": "klass-2", "E_max_MPa": 0.8},
        {"name": "klass-3"},
    ]
}
FIRST = date(2026, 8, 1)
ENGLISH = r"""(?ix)\b(?:the|of|and|or|with|without|is|are|was|were|in\ doubt|left\ out|lots?|fruit(?!s/)|
day|days|first|mean|reads|against|needs?|more|accept|reject|below|already|about|known|gripper|
size|stated|open|end|to|on|trials|bodies|found|missing|plunger|nectarine|batch|batches)\b"""


def results(root, rng, *, day, lot, gripper, graded_after=0, doubted=0):
    """A batch of eleven fruit and a reference body, with readings of a penetrometer."""
    measured = FIRST + timedelta(days=day)
    records, inputs = [], {}
    for k in range(11):
        E = float(0.9 * np.exp(-0.06 * day + rng.normal(0, 0.2)))
        grasps = tuple(GraspRecord(grasp=name, E_MPa=E * by) for name, by in (("g1", 0.99), ("g2", 1.01)))
        doubts = ("E contradicts the screen.",) if k < doubted else ()
        columns = {"F": float(40 * E**0.7 * np.exp(rng.normal(0, 0.1)))}
        records.append(graded(f"F{k}", E, doubts=doubts, changes={"grasps": grasps}, columns=columns))
        inputs[f"fruits/F{k}/grasps/a.h5"] = f"{lot} {day} {gripper} {k}"
    known = {"reference": True, "reference_E_MPa": 1.0, "reference_E_sd_MPa": 0.01}
    grasps = tuple(GraspRecord(grasp=name, E_MPa=1.0 + 0.03 * day) for name in ("g1", "g2"))
    records.append(graded("B1", 1.0 + 0.03 * day, sd=0.02, changes={"grasps": grasps}, **known))
    inputs["fruits/B1/grasps/a.h5"] = f"B1 {lot} {day} {gripper}"
    return results_of(
        root / f"{lot}-{day}-{gripper}" / f"results-{graded_after}",
        records,
        day=f"{measured + timedelta(days=graded_after)}",
        inputs=inputs,
        lot=lot,
        cultivar="Big Top",
        grading=CLASSES,
        gripper={"name": gripper},
        columns={"F": "N"},
        **({"measured_on": f"{measured}"} if day else {}),
    )


@pytest.fixture(scope="module")
def outs(tmp_path_factory):
    """Three lots, two of them over four days with two grippers; one day is graded again."""
    root, rng = tmp_path_factory.mktemp("languages"), np.random.default_rng(5)
    made = [
        results(root, rng, day=day, lot=lot, gripper=gripper, doubted=day // 6)
        for day in (0, 2, 4, 6)
        for lot in ("7", "8")
        for gripper in ("G1", "G2")
    ]
    return root, [*made, results(root, rng, day=3, lot="", gripper="G1")]


def page_text(outs, language, **quality):
    """Texts of the page, its charts and attributes that are read aloud."""
    root, folders = outs
    path = root / f"{language}.html"
    path.unlink(missing_ok=True)
    wanted = HistoryWanted(
        html=path,
        language=language,
        gauge=("gripper",),
        quality=QualityWanted(oecd=1, firmness=("F=N@8mm",), **quality),
    )
    make_history(folders, wanted, now=datetime(2026, 8, 30, tzinfo=UTC))
    written = path.read_text("utf-8")
    charts = re.findall(r'id="charts">(.*?)</script>', written)[0]
    read_out = " | ".join(re.findall(r'(?:aria-label|data-head)="([^"]*)"', written))
    spec = r'"(?:title|description|caption|label|name)":"((?:[^"\\]|\\.)*)"'
    said = " | ".join([*re.findall(spec, charts), *re.findall(r'"tips":\[(.*?)\]', charts)])
    text = re.sub(r"(?s)<(style|script)\b.*?</\1>|<!--.*?-->|<[^>]*>", " ", written)
    return html.unescape(f"{text} | {read_out} | {said}")


@pytest.mark.parametrize("language", [language for language in LANGUAGES if language != "en"])
@pytest.mark.parametrize("variables", [False, True])
def test_the_whole_page_is_in_one_language(outs, language, variables):
    plan = PlanWanted(lot_size=("7=500", "8=90"), aql=4.0, variables=variables)
    english = page_text(outs, "en", accept="klass-1", plan=plan)
    assert len(re.findall(ENGLISH, english)) > 200
    said = page_text(outs, language, accept="klass-1", plan=plan)
    for as_it_is in ("Gauge R&R", "Guidelines on objective tests", "batch.toml", "--lot-size", "FRUIT"):
        said = said.replace(as_it_is, "")
    left = [said[max(0, m.start() - 60) : m.end() + 40] for m in re.finditer(ENGLISH, said)]
    assert left == []
    assert not re.search(r"\d\.\d", said.replace("2859-1", ""))
