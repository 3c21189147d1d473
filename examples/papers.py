"""Claims and figures of the four papers, and what came out, from the summaries of studies.

    python examples/papers.py FOLDER ... > docs/papers.md

Each folder holds the ``summary.json`` of a ``kedge study SCENARIO --out FOLDER``. Prints
Markdown: for each paper its claims with verdict, figures and the command that decides them, and
its own figures beside those that came out.
"""

import argparse
import json
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

PAPERS = {
    "agv": "K. Oktafianto et al., Trajectory estimation of automated guided vehicle based on "
    "linear modelling using ensemble Kalman filter",
    "omni": "R. Dixon, G. Bright, R. Harley, Robust localisation of automated guided vehicles "
    "for computer-integrated manufacturing environments",
    "auv": "Ngatini, Z. Ermayanti, E. Apriliani, H. Nurhadi, Comparison of AUV position "
    "estimation using Kalman filter, ensemble Kalman filter and fuzzy Kalman filter algorithm "
    "in the specified trajectories",
    "uwb": "J. Qiu et al., Research on AGV positioning method combined with IMU and UWB",
}
"""By how the scenarios of a paper begin."""
OF_FILES = {"--out": 2, "--force": 1, "--resume": 1, "--json": 1}
"""Options that change no figure, and how many words they take."""
HEAD = """# What the papers state, and what came out

Written by `python examples/papers.py FOLDER ...` from the results of the studies named. A claim
is true or false if the 95 % interval over the runs says so, else these runs do not decide it;
where one is not tested, the last column says why. Below the claims: the papers' own figures.
"""


def command_of(arguments: Sequence[str]) -> str:
    """The command without what says only where its results went."""
    kept, skip = [], 0
    for word in arguments:
        skip = OF_FILES.get(word, skip)
        if skip:
            skip -= 1
        else:
            kept.append(word)
    return shlex.join(["kedge", *kept])


def markdown(studies: Sequence[dict[str, Any]]) -> Iterator[str]:
    """The page, line by line."""
    yield HEAD
    for prefix, title in PAPERS.items():
        chosen = [s for s in studies if s["arguments"][1].split("-")[0] == prefix]
        if not chosen:
            continue
        yield f"## {title}\n"
        for study in chosen:
            yield f"### {study['title']}\n"
            yield f"`{command_of(study['arguments'])}` ({study['runs']} runs)\n"
            if study["claims"]:
                yield from _table(
                    ["claim", "where", "verdict", "figures", "what it means"],
                    [
                        [
                            c["text"],
                            c["source"],
                            *(
                                (c["verdict"], c["figures"])
                                if c["test"]
                                else ("not tested", "–")
                            ),
                            c["means"],
                        ]
                        for c in study["claims"]
                    ],
                )
            if study["quoted"]:
                yield from _table(
                    ["score", "there", "here", "where"],
                    [
                        [
                            f"`{q['score']}`",
                            _number(q["value"]),
                            _number(q["here"]),
                            q["source"],
                        ]
                        for q in study["quoted"]
                    ],
                )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    for row in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(cell.replace('|', '/') for cell in row)} |"
    yield ""


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def main() -> None:
    """Read the folders' summaries, and print the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    paths = [folder / "summary.json" for folder in parser.parse_args().folders]
    for path in paths:
        if not path.is_file():
            parser.error(f"{path}: there is no such file; expected what kedge study --out left")
    print("\n".join(markdown([json.loads(path.read_text("utf-8")) for path in paths])))


if __name__ == "__main__":
    main()
