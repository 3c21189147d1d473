"""Writes a program down in LLVM's assembly language: one function, events innermost.

Its one argument is a block of 64-bit words: how many events, first run, end of the runs,
whether to start afresh, where the carried numbers are; then for each array that is read its
address, the distance between runs and the number of rows; then the addresses of those that are
written. These have the axes group of runs, event, component, run within the group: what a
register holds lies side by side. With a pitch there is one run, and all that an event leaves is
one row of so many bytes.
"""

from kedge.compiler.graph import Branches, Node, Region, Unsupported
from kedge.compiler.liveness import is_needed, needed
from kedge.compiler.program import SHORT, Program
from kedge.compiler.text import LLVM_TYPES, constant, simple, suffix, type_of

NAME = "kedge_pass"
HEAD = 5
"""Words before the arrays."""


class Writer:
    """The text of one program for ``lanes`` runs at once."""

    def __init__(
        self, program: Program, lanes: int, most: int = SHORT.lines, pitch: int | None = None
    ):
        self.program, self.lanes, self.most, self.pitch = program, lanes, most, pitch
        self.needed = needed(program)
        self.lines: list[str] = []
        self.declared: set[str] = set()
        self.names: dict[int, str] = {}
        self.splats: list[dict[int, str]] = [{}]
        self.count = 0
        self.label = "entry"

    def write(self) -> str:
        """The whole module."""
        self._begin()
        for item in self.program.once.items:
            self._item(item)
        start = self._start()
        self._open_loop(start)
        self.splats.append({})
        self._region(self.program.loop)
        self._outputs()
        leaving = [self._as(n, c.varying) for n, c in self._carry(self.program.leaving)]
        self.splats.pop()
        self._close_loop(leaving)
        if len(self.lines) > self.most:
            raise Unsupported(f"{len(self.lines)} instructions, more than {self.most}")
        body = "\n".join(self.lines)
        head = "\n".join(sorted(self.declared))
        return f"{head}\ndefine void @{NAME}(ptr %block) {{\n{body}\n}}\n"

    def _line(self, line: str) -> None:
        self.lines.append(f"  {line}")

    def _new(self, instruction: str) -> str:
        self.count += 1
        self._line(f"%v{self.count} = {instruction}")
        return f"%v{self.count}"

    def _mark(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.label = label

    def _fresh(self) -> str:
        self.count += 1
        return f"l{self.count}"

    def _word(self, place: int, kind: str = "i64") -> str:
        at = self._new(f"getelementptr i64, ptr %block, i64 {place}")
        return self._new(f"load {kind}, ptr {at}, !invariant.load !0")

    # The frame: groups of runs, what is done once for each, the loop over events.

    def _begin(self) -> None:
        self.declared.add("!0 = !{}")
        self._mark("entry")
        self.events, self.first, self.end, self.is_fresh = (self._word(i) for i in range(4))
        self.carry = self._word(4, "ptr")
        arguments = self.program.arguments
        words = {
            number: [
                self._word(HEAD + 3 * number + i, "ptr" if i == 0 else "i64") for i in range(3)
            ]
            for number in sorted(self._read())
        }
        self.rows = {number: word[2] for number, word in words.items()}
        out = [
            self._word(HEAD + 3 * len(arguments) + k, "ptr")
            for k in range(len(self.program.outputs))
        ]
        last = self._new(f"sub i64 {self.end}, 1")
        self._line("br label %groups")
        self._mark("groups")
        self._line(f"%group = phi i64 [ {self.first}, %entry ], [ %next_group, %group_done ]")
        going = self._new(f"icmp slt i64 %group, {self.end}")
        self._line(f"br i1 {going}, label %once, label %done")
        self._mark("done")
        self._line("ret void")
        self._mark("once")
        self.runs = []
        for lane in range(self.lanes):
            run = self._new(f"add i64 %group, {lane}")
            over = self._new(f"icmp sgt i64 {run}, {last}")
            # A lane beyond the last run does that one again, and writes the same.
            self.runs.append(self._new(f"select i1 {over}, i64 {last}, i64 {run}"))
        self.bases = {n: self._bases(n, word) for n, word in words.items()}
        self.out = [self._out_base(k, address) for k, address in enumerate(out)]
        slots = len(self.program.carried)
        self.slots = []
        for run in self.runs:
            place = self._new(f"mul i64 {run}, {slots}")
            self.slots.append(self._new(f"getelementptr i64, ptr {self.carry}, i64 {place}"))

    def _read(self) -> set[int]:
        numbers: set[int] = set()

        def look(region: Region) -> None:
            for item in region.items:
                if isinstance(item, Branches):
                    for inside, _ in item.cases:
                        look(inside)
                elif item.key in self.needed and item.op in ("load", "rows"):
                    numbers.add(item.param[0] if item.op == "load" else item.param)

        look(self.program.once)
        look(self.program.loop)
        return numbers

    def _bases(self, number: int, word: list[str]) -> list[str]:
        argument = self.program.arguments[number]
        if not argument.per_run or self.lanes == 1:
            return [word[0]]
        kind = _memory(argument.kind)
        offsets = [self._new(f"mul i64 {run}, {word[1]}") for run in self.runs]
        return [self._new(f"getelementptr {kind}, ptr {word[0]}, i64 {m}") for m in offsets]

    def _out_base(self, k: int, address: str) -> str:
        output = self.program.outputs[k]
        row = self._new(f"mul i64 {self.events}, {len(output.nodes)}")
        kind = _memory(output.kind)
        # Groups begin at multiples of the lanes, so that is where the group's block begins.
        offset = self._new(f"mul i64 %group, {row}")
        return self._new(f"getelementptr {kind}, ptr {address}, i64 {offset}")

    def _carry(self, nodes: list[Node]) -> list[tuple[Node, Node]]:
        return list(zip(nodes, self.program.carried, strict=True))

    def _start(self) -> list[str]:
        """Names of what is carried into the first event: computed, or kept from before."""
        fresh = self._new(f"icmp ne i64 {self.is_fresh}, 0")
        anew = [
            self._as(node, symbol.varying) for node, symbol in self._carry(self.program.start)
        ]
        begun = self.label
        self.origins = begun, "resume"
        self._line(f"br i1 {fresh}, label %events, label %resume")
        self._mark("resume")
        kept = []
        for place, symbol in enumerate(self.program.carried):
            lanes = self._lanes(symbol)
            each = []
            for slot in self.slots[:lanes]:
                at = self._new(f"getelementptr i64, ptr {slot}, i64 {place}")
                each.append(self._load(symbol.kind, at, wide=True))
            kept.append(self._pack(symbol.kind, each))
        self._line("br label %events")
        return [f"[ {a}, %{begun} ], [ {b}, %resume ]" for a, b in zip(anew, kept, strict=True)]

    def _open_loop(self, start: list[str]) -> None:
        self._mark("events")
        self.phi = len(self.lines)
        self.entering = start
        for symbol in self.program.carried:
            self.names[symbol.key] = f"%c{symbol.param}"
        self._line("%going = icmp slt i64 %event, " + self.events)
        self._line("br i1 %going, label %event_body, label %group_done")
        self._mark("event_body")

    def _close_loop(self, leaving: list[str]) -> None:
        self._line("%next_event = add i64 %event, 1")
        latch = self.label
        self._line("br label %events")
        lines = []
        for symbol, entering, after in zip(
            self.program.carried, self.entering, leaving, strict=True
        ):
            kind = type_of(symbol.kind, self._lanes(symbol))
            lines.append(f"  %c{symbol.param} = phi {kind} {entering}, [ {after}, %{latch} ]")
        lines.append(
            "  %event = phi i64 "
            + ", ".join(f"[ 0, %{o} ]" for o in self.origins)
            + f", [ %next_event, %{latch} ]"
        )
        self.lines[self.phi : self.phi] = lines
        self._mark("group_done")
        for place, symbol in enumerate(self.program.carried):
            for lane, slot in enumerate(self.slots):
                at = self._new(f"getelementptr i64, ptr {slot}, i64 {place}")
                value = self._lane(symbol, f"%c{symbol.param}", lane)
                self._store(symbol.kind, value, at, wide=True)
        self._line(f"%next_group = add i64 %group, {self.lanes}")
        self._line("br label %groups")

    def _outputs(self) -> None:
        for output, base in zip(self.program.outputs, self.out, strict=True):
            size, kind = len(output.nodes), _memory(output.kind)
            unit = kind if self.pitch is None else "i8"
            row = self._new(f"mul i64 %event, {self.pitch or size * self.lanes}")
            start = self._new(f"getelementptr {unit}, ptr {base}, i64 {row}")
            for place, node in enumerate(output.nodes):
                at = self._new(f"getelementptr {kind}, ptr {start}, i64 {place * self.lanes}")
                value, many = self._as(node, True), type_of(output.kind, self.lanes)
                if output.kind == "b1":
                    byte = type_of("u1", self.lanes)
                    value = self._new(f"zext {many} {value} to {byte}")
                    many = byte
                self._line(f"store {many} {value}, ptr {at}, align {_bytes(output.kind)}")

    # Nodes.

    def _region(self, region: Region) -> None:
        for item in region.items:
            self._item(item)

    def _item(self, item: Node | Branches) -> None:
        if isinstance(item, Branches):
            if is_needed(item, self.needed):
                self._branch(item)
        elif item.key in self.needed and item.op not in ("const", "carry", "event"):
            self.names[item.key] = self._instruction(item)

    def _branch(self, branches: Branches) -> None:
        results = [node for node in branches.results if node.key in self.needed]
        index = self._name(branches.index)
        labels = [self._fresh() for _ in branches.cases]
        merge = self._fresh()
        table = " ".join(f"i64 {i}, label %{label}" for i, label in enumerate(labels[:-1]))
        self._line(f"switch i64 {index}, label %{labels[-1]} [ {table} ]")
        arriving: list[tuple[str, list[str]]] = []
        for label, (region, values) in zip(labels, branches.cases, strict=True):
            self._mark(label)
            self.splats.append({})
            self._region(region)
            wanted = [values[node.param[1]] or node for node in results]
            given = [
                self._as(value, node.varying)
                for value, node in zip(wanted, results, strict=True)
            ]
            self.splats.pop()
            self._line(f"br label %{merge}")
            arriving.append((self.label, given))
        self._mark(merge)
        for place, node in enumerate(results):
            kind = type_of(node.kind, self._lanes(node))
            given = ", ".join(f"[ {values[place]}, %{label} ]" for label, values in arriving)
            self.names[node.key] = self._new(f"phi {kind} {given}")

    def _lanes(self, node: Node) -> int:
        return self.lanes if node.varying else 1

    def _name(self, node: Node) -> str:
        if node.is_const:
            return constant(node.param[1], node.kind, 1)
        return "%event" if node.op == "event" else self.names[node.key]

    def _as(self, node: Node, varying: bool) -> str:
        """A node's name, spread over the lanes if they are asked for and it is one number."""
        if not varying or node.varying or self.lanes == 1:
            return self._name(node)
        if node.is_const:
            return constant(node.param[1], node.kind, self.lanes)
        for known in self.splats:
            if node.key in known:
                return known[node.key]
        many, one = type_of(node.kind, self.lanes), LLVM_TYPES[node.kind]
        first = self._new(f"insertelement {many} poison, {one} {self._name(node)}, i32 0")
        zeros = f"<{self.lanes} x i32> zeroinitializer"
        spread = self._new(f"shufflevector {many} {first}, {many} poison, {zeros}")
        self.splats[-1][node.key] = spread
        return spread

    def _instruction(self, node: Node) -> str:
        lanes = self._lanes(node)
        if node.op == "load":
            return self._memory_load(node)
        if node.op == "rows":
            return self.rows[node.param]
        if node.op == "all":
            return self._all(node)
        if node.op == "call":
            return self._call(node)
        if node.op == "select":
            flag, yes, no = node.args
            kind, test = type_of(node.kind, lanes), type_of("b1", self._lanes(flag))
            a, b = self._as(yes, node.varying), self._as(no, node.varying)
            return self._new(f"select {test} {self._name(flag)}, {kind} {a}, {kind} {b}")
        args = [self._as(arg, node.varying) for arg in node.args]
        text, declaration = simple(node, args, lanes)
        if declaration:
            self.declared.add(declaration)
        return self._new(text)

    def _all(self, node: Node) -> str:
        (flag,) = node.args
        name = self._name(flag)
        if flag.varying and self.lanes > 1:
            function = f"@llvm.vector.reduce.and.{suffix('b1', self.lanes)}"
            kind = type_of("b1", self.lanes)
            self.declared.add(f"declare i1 {function}({kind})")
            name = self._new(f"call i1 {function}({kind} {name})")
        return self._new(f"zext i1 {name} to i64")

    def _call(self, node: Node) -> str:
        types = ", ".join(["double"] * len(node.args))
        self.declared.add(f"declare double @{node.param}({types})")
        each = []
        for lane in range(self._lanes(node)):
            given = [f"double {self._lane(arg, self._name(arg), lane)}" for arg in node.args]
            each.append(self._new(f"call double @{node.param}({', '.join(given)})"))
        return self._pack(node.kind, each)

    def _memory_load(self, node: Node) -> str:
        number, more = node.param
        (index,) = node.args
        bases, kind = self.bases[number], _memory(node.kind)
        name = self._name(index)
        each: list[str] = []
        for lane in range(self._lanes(node)):
            place = self._lane(index, name, lane)
            base = bases[lane if len(bases) > 1 else 0]
            at = self._new(f"getelementptr {kind}, ptr {base}, i64 {place}")
            if more:
                at = self._new(f"getelementptr {kind}, ptr {at}, i64 {more}")
            each.append(self._load(node.kind, at))
        return self._pack(node.kind, each)

    def _lane(self, node: Node, name: str, lane: int) -> str:
        """One run's number."""
        if not node.varying or self.lanes == 1:
            return name
        kind = type_of(node.kind, self.lanes)
        return self._new(f"extractelement {kind} {name}, i32 {lane}")

    def _pack(self, kind: str, each: list[str]) -> str:
        if len(each) == 1:
            return each[0]
        many, one = type_of(kind, self.lanes), LLVM_TYPES[kind]
        name = "poison"
        for lane, value in enumerate(each):
            name = self._new(f"insertelement {many} {name}, {one} {value}, i32 {lane}")
        return name

    def _load(self, kind: str, at: str, wide: bool = False) -> str:
        if wide and kind[0] != "f":
            value = self._new(f"load i64, ptr {at}")
            return (
                value
                if kind[1] == "8"
                else self._new(f"trunc i64 {value} to {LLVM_TYPES[kind]}")
            )
        note = "" if wide else ", !invariant.load !0"
        value = self._new(f"load {_memory(kind)}, ptr {at}{note}")
        return self._new(f"icmp ne i8 {value}, 0") if kind == "b1" else value

    def _store(self, kind: str, value: str, at: str, wide: bool = False) -> None:
        if wide and kind[0] != "f" and kind[1] != "8":
            word = "sext" if kind[0] == "i" else "zext"
            value = self._new(f"{word} {LLVM_TYPES[kind]} {value} to i64")
            self._line(f"store i64 {value}, ptr {at}")
            return
        if kind == "b1":
            value = self._new(f"zext i1 {value} to i8")
        self._line(f"store {_memory(kind)} {value}, ptr {at}")


def _bytes(kind: str) -> int:
    return 1 if kind == "b1" else int(kind[1:])


def _memory(kind: str) -> str:
    if kind not in LLVM_TYPES:
        raise Unsupported(f"numbers of kind {kind}")
    return "i8" if kind == "b1" else LLVM_TYPES[kind]
