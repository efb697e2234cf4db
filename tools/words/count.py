"""Counts private words and dense constructs in the Rust code and the documents of commits: count.py COMMIT...

Prints a table in Markdown with one column per commit. docs/results/words.md says what the numbers are for. Words are
counted in the whole text of every .rs file, also in comments and string literals, and in every .md file but words.md.
"""

import argparse
import io
import re
import subprocess
import tarfile
from collections.abc import Iterator

# Words that had private meanings, and those in place of an actor or of a reason. `looks` and so on count too.
WORDS = {
    "`turn`": "turn(?:s|ed|ing)?",
    "`room`": "rooms?",
    "`look`": "look(?:s|ed|ing)?",
    "`picture`": "pictures?",
    "`wish`": "wish(?:es|ed)?",
    "`way`": "ways?",
    "`told`, `hears`": "told|hears?|heard",
    "`so many`": r"so\s+many",
    "`nobody`": "nobody",
    "`somebody`": "somebody",
    "`by itself`": r"by\s+itself",
}
# Functions with the name of too many jobs.
LOOK_FUNCTION = re.compile(r"\bfn look\w*")

# `(a, b) = (`, with or without `let` and a type. The values are read by `is_tuple_statement`.
TUPLE_ASSIGNMENT = re.compile(r"^[ \t]*(?:let )?\([^()=;{}]*,[^()=;{}]*\)(?:: [^=;]*)? =\s*(?=\()", re.MULTILINE)
# Also with a type, and with the closure on the next line, where rustfmt puts it if it is long: a search for `let name = |`
# in single lines finds half of them only.
NAMED_CLOSURE = re.compile(r"\blet (?:mut )?\w+(?:: [^=;]*)? =\s*(?:move )?\|")
DOC_LINE = re.compile(r"^[ \t]*//[/!](?!/)(.*)$")


# It lists the words.
NOT_COUNTED = "docs/results/words.md"


def texts(commit: str, suffix: str) -> Iterator[str]:
    """The texts of all files of a commit whose names end in this suffix."""
    command = ["git", "archive", "--format=tar", commit]
    archive = subprocess.run(command, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        for member in files:
            is_counted = member.name.endswith(suffix) and member.name != NOT_COUNTED
            file = files.extractfile(member) if is_counted else None
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


def times(pattern: str, all_texts: list[str]) -> int:
    """How often a pattern of whole words occurs, in any case."""
    word = re.compile(rf"\b(?:{pattern})\b", re.IGNORECASE)
    return sum(len(word.findall(text)) for text in all_texts)


def count(commit: str) -> dict[str, str]:
    """Every measure of one commit, as the table shows it."""
    rust = list(texts(commit, ".rs"))
    documents = list(texts(commit, ".md"))
    lines = sum(text.count("\n") for text in rust)
    tuples = sum(is_tuple_statement(text, found.end()) for text in rust for found in TUPLE_ASSIGNMENT.finditer(text))
    closures = sum(len(NAMED_CLOSURE.findall(text)) for text in rust)
    lengths = [len(block.split()) for text in rust for block in doc_blocks(text)]
    return {
        "lines of Rust / of documents": f"{lines:,} / {sum(text.count(chr(10)) for text in documents):,}",
        "tuple assignments (per 1,000 lines)": f"{tuples} ({1000 * tuples / lines:.2f})",
        "closures with a name (per 1,000 lines)": f"{closures} ({1000 * closures / lines:.2f})",
        "documentation of one word": f"{lengths.count(1)}",
        "documentation of one or two words": f"{lengths.count(1) + lengths.count(2)}",
        "functions `look...`": f"{sum(len(LOOK_FUNCTION.findall(text)) for text in rust)}",
        **{word: f"{times(pattern, rust):,} / {times(pattern, documents):,}" for word, pattern in WORDS.items()},
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
