"""Counts private words and dense constructs in the Rust code of commits: count.py COMMIT...

Prints a table in Markdown with one column per commit. docs/results/words.md says what the numbers are for. Occurrences
are counted in the whole text of every .rs file, also in comments and string literals.
"""

import argparse
import io
import re
import subprocess
import tarfile
from collections.abc import Iterator

# Words that had private meanings (a tick, an image, an observation), and one in place of an actor. Plurals count too.
WORDS = {"`turn(s)`": "turns?", "`picture(s)`": "pictures?", "`look(s)`": "looks?", "`nobody`": "nobody"}

# `(a, b) = (`, with or without `let` and a type. The values are read by `is_tuple_statement`.
TUPLE_ASSIGNMENT = re.compile(r"^[ \t]*(?:let )?\([^()=;{}]*,[^()=;{}]*\)(?:: [^=;]*)? =\s*(?=\()", re.MULTILINE)
NAMED_CLOSURE = re.compile(r"\blet (?:mut )?\w+(?:: [^=;]*)? =\s*(?:move )?\|")
DOC_LINE = re.compile(r"^[ \t]*//[/!](?!/)(.*)$")


def rust_files(commit: str) -> Iterator[str]:
    """The texts of all Rust files of a commit."""
    command = ["git", "archive", "--format=tar", commit]
    archive = subprocess.run(command, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        for member in files:
            file = files.extractfile(member) if member.name.endswith(".rs") else None
            if file is not None:
                yield file.read().decode()


def is_tuple_statement(text: str, start: int) -> bool:
    """Whether the bracket at `start` closes before a semicolon, so that the whole right side is a tuple."""
    depth = 0
    for at in range(start, len(text)):
        if text[at] in "([{":
            depth += 1
        elif text[at] in ")]}":
            depth -= 1
        if depth == 0:
            return text.startswith(";", at + 1)
    return False


def doc_blocks(text: str) -> Iterator[str]:
    """Documentation: `///` or `//!` on consecutive lines is one block."""
    block: list[str] = []
    for line in [*text.splitlines(), ""]:
        found = DOC_LINE.match(line)
        if found:
            block.append(found.group(1))
        elif block:
            yield " ".join(block)
            block = []


def count(commit: str) -> dict[str, str]:
    """Every measure of one commit, as the table shows it."""
    lines, tuples, closures = 0, 0, 0
    one_word, two_words = 0, 0
    words = dict.fromkeys(WORDS, 0)
    for text in rust_files(commit):
        lines += text.count("\n")
        tuples += sum(is_tuple_statement(text, found.end()) for found in TUPLE_ASSIGNMENT.finditer(text))
        closures += len(NAMED_CLOSURE.findall(text))
        lengths = [len(block.split()) for block in doc_blocks(text)]
        one_word += lengths.count(1)
        two_words += lengths.count(2)
        for word, pattern in WORDS.items():
            words[word] += len(re.findall(rf"\b{pattern}\b", text, re.IGNORECASE))
    return {
        "lines of Rust": f"{lines:,}",
        "tuple assignments per 1,000 lines": f"{1000 * tuples / lines:.2f}",
        "closures with a name per 1,000 lines": f"{1000 * closures / lines:.2f}",
        "documentation of one word": f"{one_word}",
        "documentation of one or two words": f"{one_word + two_words}",
        **{word: f"{times:,}" for word, times in words.items()},
    }


def main() -> None:
    """Prints one column for each commit."""
    parser = argparse.ArgumentParser(description="Counts private words and dense constructs in Rust code.")
    parser.add_argument("commits", nargs="+", metavar="COMMIT", help="anything that git resolves to a commit")
    commits = parser.parse_args().commits
    columns = [count(commit) for commit in commits]
    print("| | " + " | ".join(f"`{commit}`" for commit in commits) + " |")
    print("|---|" + "---|" * len(commits))
    for measure in columns[0]:
        print(f"| {measure} | " + " | ".join(column[measure] for column in columns) + " |")


if __name__ == "__main__":
    main()
