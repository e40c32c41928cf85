"""From folders of photos to a batch, the settings' template and schema, doctor."""

import json
import re
import shutil
import tomllib
from datetime import date
from pathlib import Path

import pytest

from pipeline.batch.new_batch import TEMPLATE
from pipeline.batch.opening import open_batch
from pipeline.batch.settings import Settings, settings_schema
from samples.shipped import write_shipped


def keys(table, tables, at=""):
    """Every key of a table of the settings' schema, with its table's name before it."""
    for name, key in table["properties"].items():
        inner = re.findall(r"#/\$defs/(\w+)", json.dumps(key))
        yield from (within for other in inner for within in keys(tables[other], tables, f"{at}{name}."))
        if not inner:
            yield f"{at}{name}"


def filled(**others):
    """The template with every line taken in, and other values where two keys exclude each other."""
    text = TEMPLATE.read_text("utf-8").format(category="nectarine", known="")
    lines = [re.sub(r"^# (?=[\w\[]+.*(=|\]\]?$|\]\]? ))", "", line) for line in text.splitlines()]
    return "\n".join(line for line in lines if not any(line.startswith(name) for name in others))


def test_the_template_has_every_key_and_the_reader_takes_it():
    text = TEMPLATE.read_text("utf-8").format(category="nectarine", known="apricot, ...")
    assert tomllib.loads(text) == {"category": "nectarine"}
    said = tomllib.loads(filled(coin_mm="", effect="", **{"[[mismatch]]": ""}))
    Settings.model_validate(said)
    schema = settings_schema()
    for name in keys(schema, schema["$defs"]):
        if not name.startswith("mismatch."):
            key = name.rpartition(".")[2]
            assert re.search(rf"^(# )?({key} = |\[{key}\])", text, re.MULTILINE), name
    assert "# [[mismatch]]" in text


def test_the_schema_is_the_reader_s():
    schema = settings_schema()
    assert schema["required"] == ["category"]
    assert schema["additionalProperties"] is False
    assert set(schema["properties"]) == set(Settings.model_fields)
    published = Path(__file__).parents[2] / "docs" / "batch.schema.json"
    assert json.loads(published.read_text()) == schema, "write it anew: drupe schema > docs/batch.schema.json"
    assert set(schema["$defs"]["GradingClass"]["properties"]) == {"name", "E_max_MPa", "ship"}


@pytest.fixture
def photos(tmp_path):
    """A folder of two fruit, one with a name that accents decompose."""
    write_shipped("nectarines", tmp_path / "shipped")
    taken = sorted((tmp_path / "shipped" / "fruits" / "N01" / "photos").iterdir())
    for name, count in (("N2", 14), ("Mu\u0308hle 1", 3)):
        (tmp_path / "taken" / name).mkdir(parents=True)
        for path in taken[:count]:
            shutil.copy(path, tmp_path / "taken" / name)
    (tmp_path / "taken" / "notes.txt").write_text("mine")
    return tmp_path / "taken"


def test_photos_become_a_batch_and_what_is_missing_is_said(drupe, photos, tmp_path):
    before = sorted((path, path.stat().st_mtime_ns) for path in photos.rglob("*"))
    made = drupe("new", tmp_path / "batch", "--photos", photos, status=0)
    assert "2 fruit, 17 photos, 0 recordings" in made.out
    assert "missing: photos: Mühle 1 has fewer than 12" in made.out
    assert "missing: scale: write height_mm" in made.out
    assert "missing: grasps: Mühle 1, N2 have no recording" in made.out
    assert sorted((path, path.stat().st_mtime_ns) for path in photos.rglob("*")) == before
    table = tmp_path / "batch" / "fruits.csv"
    table.write_text(table.read_text().replace("N2,", "N2,58").replace("Mühle 1,", "Mühle 1,57"))
    batch = open_batch(tmp_path / "batch")
    assert [row.fruit_id for row in batch.rows] == ["Mühle 1", "N2"]
    assert [len(batch.folder.fruit(row.fruit_id).photo_files()) for row in batch.rows] == [3, 14]


EARLIER = """\
category = "peach"
cultivar = "Red Haven"
lot = "H-07"
measured_on = 2026-08-14
pulp_temperature_C = 8.0
rig = "rig.toml"
calibration_days = 90
[temperature]
reference_C = 20.0
E_per_C = -0.012
E_per_C_sd = 0.004
[sensor]
name = "20x20 marker gel"
calibrated_on = 2026-06-01
[columns]
Brix = "°Brix"
"box no." = ""
[[grading.classes]]
name = "soft"
E_max_MPa = 0.35
[[grading.classes]]
name = "firm"
ship = true
[[mismatch]]
effect = "sensor_gain"
parameters = { pad = "left", gain = 1.138 }
sd = { gain = 0.011 }
"""


@pytest.fixture
def earlier(tmp_path):
    root = tmp_path / "monday"
    root.mkdir()
    (root / "batch.toml").write_text(EARLIER, "utf-8")
    (root / "rig.toml").write_text("# a rig")
    (root / "mat.json").write_text("{}")
    (root / "fruits.csv").write_text("fruit_id\nA\n")
    return root


def test_a_batch_like_an_earlier_one_has_its_settings_but_those_of_the_day(drupe, earlier, photos, tmp_path):
    made = drupe(
        "new", tmp_path / "tuesday", "--like", earlier, "--lot", 'H-08 "b"', "--photos", photos, status=0
    )
    written = tomllib.loads((tmp_path / "tuesday" / "batch.toml").read_text("utf-8"))
    expected = tomllib.loads(EARLIER)
    for name in ("measured_on", "pulp_temperature_C", "temperature", "mismatch"):
        del expected[name]
    expected["lot"] = 'H-08 "b"'
    expected["sensor"]["calibrated_on"] = "2026-06-01"
    assert written == expected
    before = Settings.model_validate(tomllib.loads(EARLIER))
    after = Settings.model_validate(written)
    assert (after.grading, after.sensor, after.columns) == (before.grading, before.sensor, before.columns)
    header = (tmp_path / "tuesday" / "fruits.csv").read_text("utf-8").splitlines()[0]
    assert header.endswith(",notes,Brix,box no.")
    assert (tmp_path / "tuesday" / "rig.toml").read_text() == "# a rig"
    assert (tmp_path / "tuesday" / "mat.json").is_file()
    assert "missing: scale" not in made.out
    for said in (
        "pulp_temperature_C: write that of the new day into batch.toml, and again [temperature] "
        "reference_C = 20, E_per_C = -0.012, E_per_C_sd = 0.004",
        "confirmed effects (sensor_gain): drupe copies none",
    ):
        assert said in made.out
    assert (earlier / "batch.toml").read_text("utf-8") == EARLIER


def test_a_file_outside_the_earlier_batch_is_named_where_it_means_another(drupe, earlier, tmp_path):
    (earlier / "batch.toml").write_text(EARLIER.replace('"rig.toml"', '"../rig.toml"'), "utf-8")
    assert "../rig.toml" not in drupe("new", tmp_path / "beside", "--like", earlier).out
    (tmp_path / "deeper").mkdir()
    made = drupe("new", tmp_path / "deeper" / "tuesday", "--like", earlier)
    assert f"../rig.toml: lies outside {earlier} and now means {tmp_path / 'deeper' / 'rig.toml'}" in made.out


@pytest.mark.parametrize("link", ["rig.toml", "mat.json", "rigs"])
def test_a_link_out_of_the_earlier_batch_is_named_and_not_copied(drupe, earlier, tmp_path, link):
    """Somebody else may have made that batch, and a link of theirs may lead to any file of this user's."""
    (tmp_path / "private").mkdir()
    (tmp_path / "private" / "rig.toml").write_text("secret")
    named = "rigs/rig.toml" if link == "rigs" else link
    if link == "rigs":
        (earlier / "batch.toml").write_text(EARLIER.replace('"rig.toml"', '"rigs/rig.toml"'), "utf-8")
    (earlier / link).unlink(missing_ok=True)
    (earlier / link).symlink_to(tmp_path / "private" / ("" if link == "rigs" else "rig.toml"))
    made = drupe("new", tmp_path / "tuesday", "--like", earlier)
    assert f"missing: {earlier / named}: is a link to a file outside {earlier}, which drupe does" in made.out
    assert not (tmp_path / "tuesday" / named).exists()


def test_lot_and_cultivar_are_in_the_template(drupe, photos, tmp_path):
    named = ("--lot", "H-08", "--cultivar", "Big\\Top", "--harvest-date", "2026-08-13")
    drupe("new", tmp_path / "b", "--photos", photos, *named, status=0)
    written = tomllib.loads((tmp_path / "b" / "batch.toml").read_text("utf-8"))
    assert written.pop("harvest_date") == date(2026, 8, 13)
    assert written == {"category": "nectarine", "lot": "H-08", "cultivar": "Big\\Top"}


def test_the_new_day_s_dates_are_stated_or_asked_for(drupe, earlier, tmp_path):
    made = drupe("new", tmp_path / "tuesday", "--like", earlier, status=0)
    assert "missing: lot, measured_on: write those of the new day into batch.toml." in made.out
    stated = ("--lot", "H-08", "--measured-on", "2026-08-15")
    made = drupe("new", tmp_path / "wednesday", "--like", earlier, *stated, status=0)
    assert "measured_on" not in made.out
    written = tomllib.loads((tmp_path / "wednesday" / "batch.toml").read_text("utf-8"))
    assert written["measured_on"] == date(2026, 8, 15)


def test_a_batch_without_fruit_says_how_to_add_some(drupe, earlier, tmp_path):
    made = drupe("new", tmp_path / "tuesday", "--like", earlier, status=0)
    assert f"missing: fruit: for each fruit, put photos/ and grasps/ into {tmp_path / 'tuesday'}" in made.out
    assert "next: add fruit, then run `drupe check" in made.out
    checked = drupe("check", tmp_path / "tuesday", status=2)
    assert "lists no fruit; add a row for each fruit below the header, and put its photos/ and" in checked.out


def test_pictures_that_are_not_copied_are_named(drupe, photos, tmp_path):
    (photos / "N2" / "more.webp").write_bytes(b"RIFF1234WEBP" + bytes(50))
    (photos / "N2" / "notes.txt").write_text("x")
    made = drupe("new", tmp_path / "batch", "--photos", photos)
    assert (
        "missing: photos of N2: more.webp is not used: drupe does not read WebP pictures; convert" in made.out
    )
    assert "notes.txt" not in made.out


def test_a_folder_with_a_decomposed_name_is_found(photos, tmp_path, drupe):
    drupe("new", tmp_path / "batch", "--photos", photos)
    fruits = tmp_path / "batch" / "fruits"
    (fruits / "Mühle 1").rename(fruits / "Mu\u0308hle 1")
    checked = drupe("check", tmp_path / "batch")
    assert "is not in fruits.csv" not in checked.out
    assert "does not exist" not in checked.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("full", "--photos", "taken"), "exists already and is not empty; name a new folder"),
        (("new", "--photos", "nothing"), "is not a folder; name a folder of photos"),
        (("new", "--photos", "empty"), "holds no photos (JPEG, PNG, HEIC), meshes or recordings"),
        (("new", "--photos", "taken", "--photos", "taken"), 'two folders have the name "N2"'),
        (("new", "--photos", "photos"), '--photos: the folder "photos" does not name a fruit; give'),
        (
            ("new", "--photos", "taken", "--category", "pear"),
            'drupe knows no category "pear"; known: apricot',
        ),
        (("new",), "drupe new: needs --photos FOLDER, --like BATCH, or both."),
        (("new", "--like", "taken"), "does not exist, but this folder has photos"),
        (("new", "--photos", "odd"), '"-x" is not a valid fruit_id'),
    ],
)
def test_what_no_batch_can_be_made_of_is_said(drupe, photos, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    (tmp_path / "empty").mkdir()
    shutil.copytree(photos / "N2", tmp_path / "odd" / "-x")
    shutil.copytree(photos / "N2", tmp_path / "photos")
    ran = drupe("new", *arguments, status=2)
    assert said in ran.err
    assert "drupe: drupe" not in ran.err
    assert not (tmp_path / "new").exists()
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["mine.txt"]


def test_grading_a_folder_of_photos_names_the_way_in(drupe, photos):
    for folder in (photos, photos / "N2"):
        ran = drupe("grade", folder, status=2)
        assert "does not exist, but this folder has photos" in ran.err
        assert f"Create a batch with `drupe new BATCH --photos {folder}`" in ran.err


def test_doctor_finds_the_known_answer_and_says_it_is_well(drupe, tmp_path):
    ran = drupe("doctor", tmp_path, status=0)
    off = re.search(r"deviation ([+-][\d.]+) % from the closed form", ran.out)
    assert abs(float(off[1])) < 0.5
    assert ran.out.endswith("all well\n")


def test_doctor_says_what_is_wrong(drupe, tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.run.machine_check.known_answer_error", lambda: 0.2)
    ran = drupe("doctor", tmp_path, status=1)
    assert "wrong: finite elements deviate by +20.0 % from a closed form" in ran.out
    monkeypatch.setattr("pipeline.run.machine_check.free_memory_MiB", lambda: 100.0)
    assert "missing: memory: 100 MiB free" in drupe("doctor", tmp_path, status=2).out


def test_schema_is_printed_as_json(drupe):
    assert json.loads(drupe("schema").out) == settings_schema()
