"""Which nodes are needed: those that results hang on, through branches too."""

from kedge.compiler.graph import Branches
from kedge.compiler.program import Program


def needed(program: Program) -> set[int]:
    """Keys of the nodes that results, or what is carried on, hang on."""
    waiting = [node for output in program.outputs for node in output.nodes]
    waiting += [*program.start, *program.carried, *program.leaving]
    keys: set[int] = set()
    while waiting:
        node = waiting.pop()
        if node.key in keys:
            continue
        keys.add(node.key)
        waiting.extend(node.args)
        if node.op == "result":
            branches, place = node.param
            waiting.append(branches.index)
            cases = (values[place] for _, values in branches.cases)
            waiting.extend(value for value in cases if value is not None)
    return keys


def is_needed(branches: Branches, needed: set[int]) -> bool:
    """Whether a branch has a result that is."""
    return any(node.key in needed for node in branches.results)
