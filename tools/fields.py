"""Comments at the fields of a record as the `Attributes` of its page: the sources say shape, unit and meaning once."""

import ast
import io
import tokenize
from pathlib import Path

import griffe


class Fields(griffe.Extension):
    """Reads `name: type  # comment`, and comments on the lines above a field."""

    def on_class_members(self, *, node, cls, agent, **kwargs):
        """Append the fields with a comment to the class's docstring."""
        if not isinstance(node, ast.ClassDef) or cls.docstring is None:
            return
        comments = comments_of(Path(cls.filepath).read_text(encoding="utf-8"))
        fields = [item for item in node.body if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)]
        told = [(item.target.id, ast.unparse(item.annotation), comment_at(item, comments)) for item in fields]
        entries = [f"{name} : {annotation}\n    {text}" for name, annotation, text in told if text]
        if entries:
            cls.docstring.value += "\n\nAttributes\n----------\n" + "\n".join(entries)


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
