"""batch.toml is read strictly, and every fault is said with its key."""

import pytest

from pipeline.config import read_settings
from pipeline.problem import BatchRefused


def refusals(tmp_path, text):
    path = tmp_path / "batch.toml"
    path.write_text(text)
    with pytest.raises(BatchRefused) as caught:
        read_settings(path)
    return [str(p) for p in caught.value.problems]


def test_only_the_category_is_required(tmp_path):
    path = tmp_path / "batch.toml"
    path.write_text('category = "plum"\n')
    assert read_settings(path).category == "plum"


def test_missing_file_is_named(tmp_path):
    with pytest.raises(BatchRefused, match=r"batch\.toml: there is no batch\.toml"):
        read_settings(tmp_path / "batch.toml")


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(BatchRefused, match="no such batch folder"):
        read_settings(tmp_path / "nowhere" / "batch.toml")


def test_unknown_key_is_refused_with_the_nearest_known_one(tmp_path):
    (line,) = refusals(tmp_path, 'category = "plum"\ncultivr = "x"\n')
    assert 'unknown key "cultivr"' in line
    assert 'did you mean "cultivar"' in line


def test_unknown_key_in_a_table_is_named_with_its_table(tmp_path):
    (line,) = refusals(tmp_path, 'category = "plum"\n[pit]\nprio = "plum"\n')
    assert 'unknown key "pit.prio"; did you mean "prior"?' in line


@pytest.mark.parametrize("table", ["sensor", "gripper", "pit", "recon", "mesh", "flesh", "grading"])
def test_unknown_key_is_named_in_every_table(tmp_path, table):
    lines = refusals(tmp_path, f'category = "plum"\n[{table}]\nnonsense = 1\n')
    assert any(f'unknown key "{table}.nonsense"' in line for line in lines)


def test_all_faults_are_said_at_once(tmp_path):
    lines = refusals(tmp_path, "poisson_ratio = 0.7\nnonsense = 1\n")
    assert len(lines) == 3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("category = ", "is not valid TOML"),
        ('category = "plum"\npoisson_ratio = 0.5\n', '"poisson_ratio": found 0.5'),
        ('category = "plum"\n[mesh]\nedge_mm = -1\n', '"mesh.edge_mm": found -1'),
        ('category = "plum"\n[[grading.classes]]\nname = "a"\nE_max_MPa = 1.0\n', "must have no E_max_MPa"),
        (
            'category = "plum"\n[[grading.classes]]\nname = "a"\nE_max_MPa = 1.0\n'
            '[[grading.classes]]\nname = "b"\nE_max_MPa = 0.5\n[[grading.classes]]\nname = "c"\n',
            "must grow from class to class",
        ),
    ],
)
def test_bad_values_are_said_with_key_and_expectation(tmp_path, text, says):
    assert any(says in line for line in refusals(tmp_path, text))


def test_a_coin_is_known_by_name_or_given_by_its_diameter(tmp_path):
    path = tmp_path / "batch.toml"
    path.write_text('category = "plum"\n[photos]\ncoin = "1 euro"\n')
    assert read_settings(path).photos.scale.diameter_mm == 23.25
    path.write_text('category = "plum"\n[photos]\ncoin_mm = 24.26\n')
    assert read_settings(path).photos.scale.diameter_mm == 24.26
    path.write_text('category = "plum"\n[photos]\ncoin = "1 Euro"\n')
    assert read_settings(path).photos.scale.diameter_mm == 23.25
    (said,) = refusals(tmp_path, 'category = "plum"\n[photos]\ncoin = "1 eur"\n')
    assert '"photos.coin": found' in said
    assert 'no coin here is called "1 eur"; did you mean "1 euro"? known are' in said
    assert "2 euro (25.75 mm)" in said
    assert ".." not in said
    (said,) = refusals(tmp_path, 'category = "plum"\n[photos]\ncoin = "1 euro"\ncoin_mm = 23.25\n')
    assert "not both" in said
