"""Changes of TOML files: comments and order stay, one step or nothing, a backup; what cannot be used is not written."""

import tomllib
from pathlib import Path

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.settings import ConfigError
from gateway.commission.files.device_file import fields_that_fit, set_block, set_device, set_tag, starter
from gateway.commission.files.toml_edit import commit, edit_file
from gateway.settings.devices import BLOCK_FIELDS, load_device
from tests.plc.bench import DECANTER


def copied(folder: Path) -> Path:
    path = folder / "plc.toml"
    path.write_bytes(DECANTER.read_bytes())
    return path


def test_a_changed_tag_changes_its_own_lines_and_nothing_else(tmp_path: Path) -> None:
    path = copied(tmp_path)
    edit = edit_file(path, lambda document: set_tag(document, "Coppia", {"address": "holding:900", "scale": 0.5}))
    before, after = path.read_text(encoding="utf-8").splitlines(), edit.after.splitlines()
    assert [(old, new) for old, new in zip(before, after, strict=True) if old != new] == [
        ('address = "holding:102"', 'address = "holding:900"'),
        ("scale = 0.1", "scale = 0.5"),
    ]
    assert edit.diff().count("\n-") == 2 + edit.diff().startswith("-")


def test_a_new_tag_comes_before_the_comments_that_lead_on(tmp_path: Path) -> None:
    path = copied(tmp_path)
    edit = edit_file(
        path, lambda document: set_tag(document, "Nuovo", {"address": "holding:200", "labels": {"0": "a"}})
    )
    comments = [line for line in path.read_text(encoding="utf-8").splitlines() if line.lstrip().startswith("#")]
    assert [line for line in edit.after.splitlines() if line.lstrip().startswith("#")] == comments
    head = edit.after[: edit.after.index("# Gateway to PLC")]
    assert head.rstrip().endswith('labels = {0 = "a"}')
    assert tomllib.loads(edit.after)["tags"][-1] == {"name": "Nuovo", "address": "holding:200", "labels": {"0": "a"}}


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["Coppia", "TFango", "Nuovo", "Altro"]),
            st.dictionaries(
                st.sampled_from(["unit", "low", "address", "scale"]),
                st.one_of(st.none(), st.sampled_from([1.5, "x", 3])),
                max_size=3,
            ),
        ),
        max_size=5,
    )
)
def test_any_changes_leave_the_rest_of_the_content_as_it_was(changes: list[tuple[str, dict[str, object]]]) -> None:
    def change(document: tomlkit.TOMLDocument) -> None:
        for name, keys in changes:
            set_tag(document, name, keys)

    wanted = tomllib.loads(DECANTER.read_text(encoding="utf-8"))
    for name, keys in changes:
        row = next((one for one in wanted["tags"] if one["name"] == name), None)
        if row is None:
            row = {"name": name}
            wanted["tags"].append(row)
        for key, value in keys.items():
            row.pop(key, None) if value is None else row.__setitem__(key, value)
    assert tomllib.loads(edit_file(DECANTER, change).after) == wanted


def test_what_cannot_be_used_is_not_written_and_the_sentence_names_the_real_file(tmp_path: Path) -> None:
    path = copied(tmp_path)
    before = path.read_bytes()
    edit = edit_file(path, lambda document: set_tag(document, "Coppia", {"dtype": "float31"}))
    with pytest.raises(ConfigError, match=r"plc\.toml: tags.*dtype.*nothing was written") as error:
        commit(edit, load_device)
    assert ".new" not in str(error.value)
    assert path.read_bytes() == before
    assert [found.name for found in tmp_path.iterdir()] == ["plc.toml"]


def test_a_change_is_written_in_one_step_with_a_backup_and_the_old_mode(tmp_path: Path) -> None:
    path = copied(tmp_path)
    path.chmod(0o640)
    before = path.read_bytes()
    edits = []
    for number in (1, 2):
        edits.append(edit_file(path, lambda document, number=number: set_device(document, {"max_registers": number})))
        backup = commit(edits[-1], load_device, now=lambda: 1_700_000_000.0)
        assert backup is not None and backup.read_text(encoding="utf-8") == edits[-1].before
    assert sorted(found.name for found in tmp_path.glob("*.bak")) == [
        "plc.toml.20231114-221320-1.bak", "plc.toml.20231114-221320.bak"
    ]  # fmt: skip
    assert (tmp_path / "plc.toml.20231114-221320.bak").read_bytes() == before
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_file_that_somebody_else_changed_meanwhile_is_left_alone(tmp_path: Path) -> None:
    path = copied(tmp_path)
    edit = edit_file(path, lambda document: set_device(document, {"unit": 3}))
    path.write_text(path.read_text(encoding="utf-8") + "# mine\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="changed by somebody else"):
        commit(edit, load_device)
    assert path.read_text(encoding="utf-8").endswith("# mine\n")


def test_windows_line_ends_stay(tmp_path: Path) -> None:
    path = tmp_path / "plc.toml"
    path.write_bytes(DECANTER.read_bytes().replace(b"\n", b"\r\n"))
    edit = edit_file(path, lambda document: set_tag(document, "Nuovo", {"address": "holding:200"}))
    assert edit.after.count("\n") == edit.after.count("\r\n")


def test_a_file_that_is_no_toml_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "plc.toml"
    path.write_text('[device]\nname = "a\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"plc.toml: is not TOML: .*line 2"):
        edit_file(path, lambda _: None)


@pytest.mark.parametrize("words", [8, 16, 26, 123])
def test_a_new_file_with_a_block_of_so_many_words_is_in_order(tmp_path: Path, words: int) -> None:
    def change(document: tomlkit.TOMLDocument) -> None:
        set_tag(document, "T", {"address": "holding:1", "dtype": "float32"})
        set_block(
            document, {"address": "holding:10", "layout_version": 2, "timeout_s": 5.0}, fields_that_fit(words), DECANTER
        )

    path = tmp_path / "new.toml"
    commit(edit_file(path, change, starter("new", "modbus")), load_device)
    layout = load_device(path).writeback
    assert layout is not None and len(layout.words) == min(words, len(BLOCK_FIELDS))
    shipped = load_device(DECANTER).writeback
    assert shipped is not None and set(layout.fields) <= set(shipped.fields)


def test_a_plc_that_takes_too_few_words_cannot_have_a_block() -> None:
    with pytest.raises(ConfigError, match="5 words in one write, and a block has at least 8"):
        fields_that_fit(5)
