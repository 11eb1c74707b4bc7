"""What the sources say of a record's fields as the `Attributes` of its page: comments, and what `Annotated` adds to a type."""

import ast
import io
import tokenize
from functools import cache
from pathlib import Path

import griffe


class Fields(griffe.Extension):
    """Reads `name: type  # comment`, comments on the lines above, and `Annotated[type, Item("unit", "meaning", axes)]`."""

    def on_class_members(self, *, node, cls, agent, **kwargs):
        """Append the fields of which something is said to the class's docstring."""
        if not isinstance(node, ast.ClassDef) or cls.docstring is None:
            return
        comments, texts = read(cls.filepath)
        entries = []
        for item in node.body:
            if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
                kind, more = split(item.annotation, texts)
                told = "; ".join(filter(None, (more, comment_at(item, comments))))
                entries += [f"{item.target.id} : {kind}\n    {told}"] if told else []
        if entries:
            cls.docstring.value += "\n\nAttributes\n----------\n" + "\n".join(entries)


@cache
def read(path):
    """Return comments and texts of a module."""
    source = Path(path).read_text(encoding="utf-8")
    return comments_of(source), texts_of(source)


def comments_of(source):
    """Return the comments by line, each with whether it has the line for itself."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {
        token.start[0]: (token.string.removeprefix("#").strip(), not token.line[: token.start[1]].strip())
        for token in tokens
        if token.type == tokenize.COMMENT
    }


def comment_at(field, comments):
    """Return the comment behind a field, else that on the lines above it; empty where there is none."""
    behind = [
        text for line in range(field.lineno, field.end_lineno + 1) for text, _ in [comments.get(line, ("", True))]
    ]
    if any(behind):
        return " ".join(filter(None, behind))
    line, above = field.lineno - 1, []
    while comments.get(line, ("", False))[1]:
        above.insert(0, comments[line][0])
        line -= 1
    return " ".join(above)


def texts_of(source):
    """Return the texts and rows of texts that a module gives a name."""
    found = {}
    for item in ast.parse(source).body:
        if isinstance(item, ast.Assign) and isinstance(item.value, ast.Constant | ast.Tuple):
            found |= {name.id: item.value for name in item.targets if isinstance(name, ast.Name)}
    return found


def split(annotation, texts):
    """Return a type, and what `Annotated` says beyond it: axes, unit and meaning, or a description."""
    if not (isinstance(annotation, ast.Subscript) and ast.unparse(annotation.value) == "Annotated"):
        return ast.unparse(annotation), ""
    kind, said = annotation.slice.elts[0], annotation.slice.elts[-1]
    if not isinstance(said, ast.Call):
        return ast.unparse(kind), ""
    words = dict(zip(("unit", "meaning", "axes"), said.args, strict=False)) if ast.unparse(said.func) == "Item" else {}
    words |= {word.arg: word.value for word in said.keywords}
    unit, meaning = (plain(words[name], texts) if name in words else "" for name in ("unit", "meaning"))
    axes = f"({plain(words['axes'], texts)})" if "axes" in words else ""
    about = plain(words["description"], texts) if "description" in words else meaning
    return ast.unparse(kind), " ".join(filter(None, (axes, f"[{unit}]" if unit not in ("", "1") else "", about)))


def plain(node, texts):
    """Return an expression of texts as text; a row is joined with commas."""
    if isinstance(node, ast.Name) and node.id in texts:
        return plain(texts[node.id], texts)
    if isinstance(node, ast.Tuple | ast.JoinedStr):
        return (", " if isinstance(node, ast.Tuple) else "").join(plain(part, texts) for part in parts(node))
    return str(node.value) if isinstance(node, ast.Constant) else ast.unparse(node)


def parts(node):
    """Return the members of a row, or of a text with values in it."""
    if isinstance(node, ast.Tuple):
        return [part.value if isinstance(part, ast.Starred) else part for part in node.elts]
    return [part.value if isinstance(part, ast.FormattedValue) else part for part in node.values]
