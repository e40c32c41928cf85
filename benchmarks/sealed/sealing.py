"""Salt, label and seal: SHA-256(salt + label) of each case, and in which order a repository got the files.

A label is canonical JSON: keys sorted, no blanks, numbers with DIGITS significant digits, so that a label
that is derived again on another machine is the same text.
"""

import hashlib
import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

DIGITS = 9
"""Significant digits of a label's numbers: fewer than machines agree on, more than any score needs."""
MANIFEST, ANSWERS, SALT, LABELS = "manifest.json", "answers.jsonl", "salt.txt", "labels.json"
"""Files of a proof, in the order in which they may become public; the last two together."""


def canonical(label: Any) -> str:
    """The one text of a label.

    >>> canonical({"b": 0.1 + 0.2, "a": [1, "x"]})
    '{"a":[1,"x"],"b":0.3}'
    """
    return json.dumps(_rounded(label), sort_keys=True, separators=(",", ":"), ensure_ascii=True)


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, Mapping):
        return {str(key): _rounded(entry) for key, entry in value.items()}
    return [_rounded(entry) for entry in value] if isinstance(value, list | tuple) else value


def sealed(salt: str, label: Any) -> str:
    """SHA-256 of salt and label, hexadecimal."""
    return hashlib.sha256((salt + canonical(label)).encode()).hexdigest()


def read_salt(path: Path) -> str:
    """The salt of a file, without the newline at its end. Raises ValueError for one that can be guessed."""
    salt = path.read_text(encoding="utf-8").strip()
    if len(salt) < 32:
        raise ValueError(f"{path} holds {len(salt)} characters; a salt has at least 32 random ones")
    return salt


def broken_seals(seals: Mapping[str, str], texts: Mapping[str, str]) -> list[str]:
    """What is wrong, a sentence for each case; empty where every hash is that of the case's text."""
    faults = []
    for case, seal in seals.items():
        if case not in texts:
            faults.append(f"{case}: no label")
        elif hashlib.sha256(texts[case].encode()).hexdigest() != seal:
            faults.append(f"{case}: the label is not the one that was sealed")
    return faults + [f"{case}: a label without a seal" for case in texts if case not in seals]


def order_of_commits(folder: Path) -> tuple[bool | None, list[str]]:
    """Whether git history has the manifest first, then the answers, then salt and labels; and what it says.

    None where that cannot be seen: no repository, or a file that was never committed. An answer that was
    changed or added after the salt's commit breaks the order.
    """
    said, commits = [], {}
    for name in (MANIFEST, ANSWERS, SALT, LABELS):
        log = _git(folder, "log", "--format=%H %cI", "--", name)
        if log is None:
            return None, ["not in a git repository: the order of the files could not be verified"]
        if not log:
            return None, [f"{name} was never committed: the order of the files could not be verified"]
        commits[name] = [line.split()[0] for line in log.splitlines()]
        said.append(f"{name}: first {log.splitlines()[-1]}, last {log.splitlines()[0]}")
    faults = []
    if len(commits[MANIFEST]) > 1:
        faults.append(f"{MANIFEST} was changed after its first commit")
    faults += [
        f"{name} differs from what was committed"
        for name in commits
        if _git(folder, "diff", "--quiet", "HEAD", "--", name) is None
    ]
    for answer in commits[ANSWERS]:
        if not _is_before(folder, commits[MANIFEST][-1], answer):
            faults.append(f"the answers of {answer[:12]} do not come after the manifest")
        faults += [
            f"the answers of {answer[:12]} do not come before salt and labels ({salt[:12]})"
            for salt in (commits[SALT][-1], commits[LABELS][-1])
            if not _is_before(folder, answer, salt)
        ]
    return not faults, [*said, *faults]


def _is_before(folder: Path, first: str, second: str) -> bool:
    """Whether one commit is an ancestor of another, and not the same."""
    return first != second and _git(folder, "merge-base", "--is-ancestor", first, second) is not None


def _git(folder: Path, *command: str) -> str | None:
    """What git prints; None where it fails, or is not there."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *command], capture_output=True, text=True, check=False
        )
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None
