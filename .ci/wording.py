#!/usr/bin/env python3
"""Checks pages, comments, help and messages for patterns that English technical prose does not have.

    python3 .ci/wording.py

Prints each finding with what to write instead, and ends with status 1 if there is any."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# Pattern -> what to write instead. Patterns ignore case and match across line ends.
RULES = {
    r"lessons?|teach(es|ing)?|learners?": "training pass; train; trainer",
    r"promises?|promised|promising": "predicts; a predicted gain",
    r"what (is|are) seen of|what it knows|what (was|is) kept|all that learn": "a noun: visibility; the checkpoint",
    r"(that|which) (is|are) no (?!longer|more|less|worse|better|larger|smaller|farther|other)[a-z]+": "not a ...; non-...",
    r"(so|as) many \w+ as there are|one (number|of them) each": "one ... per ...; n ...",
    r"comes? up to|by the clock|is level with|loses to|is ahead of": "matches; has lower MSE at equal time; is worse than",
    r"a (half|third|quarter|fifth|sixth|seventh|eighth|ninth|tenth) (less|more|longer|shorter|lower|higher|faster|slower|fewer|better|worse)":
        "a percentage",
    r"[\d.]+(x| times) (less|fewer|smaller) (error|noise|variance|mse)": "MSE 1.6x lower",
    r"times as (little|few)": "1.6x lower",
    r"refused with a sentence|with a sentence that": "rejected with an error that names",
    r"since then|the goal of \d|the goal (is|was) (met|missed)|tried without gain|used to be": "the state as it is",
    r"comes? with (a|an|its|the)\b": "has; includes",
    r"tells? the time left": "progress is logged",
    r"as it is of now|of now\b|as of today": "the state as it is",
    r"may come to gain|whether it may": "whether ... could",
    r"(struct|enum|trait|type) (Place|Known|Worth|Surroundings|Yardstick|Workshop|Laboratory|Standing|Ready|Made|Kept|Sent|Strands|Tears|Work|Lesson|Learner)\b":
        "a term of the field",
    r"fn what_\w+|fn nothing_\w+|fn who_\w+": "a test name that states the property: subject_verb_object",
}  # fmt: skip
PATTERNS = [(re.compile(rf"(?<!\w)(?:{pattern})(?!\w)".replace(" ", r"\s+(?://[/!]?\s*|#\s*)?"), re.IGNORECASE), instead)
            for pattern, instead in RULES.items()]  # fmt: skip
# Quoted from elsewhere, or about these words.
EXCEPT = {".ci/wording.py", "_typos.toml", "Cargo.lock"}
GENERATED = re.compile(r"<!-- results:.*?<!-- end of results -->|```.*?```", re.DOTALL)


def main():
    listed = subprocess.run(["git", "ls-files", "*.md", "*.rs", "*.py", "*.toml", "*.h"], cwd=ROOT, capture_output=True, text=True, check=True)
    findings = 0
    for name in listed.stdout.split():
        if name in EXCEPT:
            continue
        text = (ROOT / name).read_text()
        if name.endswith(".md"):
            text = GENERATED.sub(lambda block: "\n" * block[0].count("\n"), text)
        for pattern, instead in PATTERNS:
            for match in pattern.finditer(text):
                line = text.count("\n", 0, match.start()) + 1
                print(f"{name}:{line}: '{' '.join(match[0].split())}'; write: {instead}", file=sys.stderr)
                findings += 1
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
