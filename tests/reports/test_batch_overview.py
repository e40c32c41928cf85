"""The first screen: lists, classes, and failures that share a cause."""

from dataclasses import replace

from reports.batch_overview import MOST_LINKED, MOST_LISTED, class_counts, decision_lists, failures, numbered
from reports.entries import FruitEntry
from reports.page import report_html


def lost(fruit_id, reason, outcome="never-touches"):
    return FruitEntry(
        fruit_id=fruit_id,
        ok=False,
        outcome=outcome,
        reason=reason,
        decision="inspect",
        decision_reason="not graded",
    )


def test_failures_of_one_cause_are_one_and_their_numbers_do_not_part_them(empty_batch):
    fruits = (
        lost("A", "grasp-1 of A misses it by 3.2 mm."),
        lost("B", "grasp-1 of B misses it by 14 mm."),
        lost("C", "Two photos.", "too-few-views"),
        lost("D", "One is black.", "too-few-views"),
        lost("E", "None.", "too-few-views"),
    )
    groups = failures(numbered(replace(empty_batch, fruits=fruits)))
    assert [(failure.outcome, len(failure.fruits)) for failure in groups] == [
        ("too-few-views", 3),
        ("never-touches", 2),
    ]
    assert groups[0].same_reason == ""
    assert groups[1].same_reason == "grasp-1 of A misses it by 3.2 mm."
    page = report_html(replace(empty_batch, fruits=fruits))
    assert "2 fruit <code>never-touches</code>" in page
    assert page.count("Check that the gripper closed on the fruit") == 1 + 2  # once, and in each fruit's part
    assert "One is black." in page


def test_lists_name_their_fruit_and_why(empty_batch, graded):
    fruits = (
        replace(graded("S", rank=1, E_MPa=0.2), decision="ship"),
        replace(graded("H", rank=3, E_MPa=0.9, maturity="unripe"), decision="hold"),
        replace(
            graded("B", rank=2, E_MPa=0.34),
            decision="inspect",
            decision_reason="borderline: ship with probability 63 %",
            other_class="unripe",
            other_class_probability=0.37,
        ),
        lost("L", "No."),
    )
    batch = replace(empty_batch, fruits=fruits, classes=(("ripe", 0.35), ("unripe", None)), ships=("ripe",))
    lists = decision_lists(batch, numbered(batch))
    assert [[fruit.fruit_id for _, fruit in list_.fruits] for list_ in lists] == [["S"], ["H"], ["B", "L"]]
    assert [reason for reason, _ in lists[2].groups] == ["borderline", "not graded"]
    assert class_counts(batch, numbered(batch)) == (("ripe", 2, 1), ("unripe", 1, 0))
    page = report_html(batch)
    assert "or unripe (37" in page
    assert '<option value="hold">Hold</option>' in page


def test_long_lists_have_few_links_and_the_table_has_the_rest(large_batch, graded):
    count = MOST_LISTED + 10
    fruits = tuple(
        replace(graded(f"N-{k:03d}", rank=k + 1, E_MPa=0.2 + 0.002 * k), decision="ship")
        for k in range(count)
    )
    page = report_html(replace(large_batch, fruits=fruits, ships=("ripe",)))
    card = page[page.index('class="card ship"') : page.index('class="card hold"')]
    assert card.count('href="#fruit-') == MOST_LINKED
    assert f'<a href="#list=ship">all {count} in the table</a>' in card
    assert "See the table of all fruits." in card
    few = report_html(replace(large_batch, fruits=fruits[:20], ships=("ripe",)))
    assert ", ".join(fruit.fruit_id for fruit in fruits[:20]) in few
