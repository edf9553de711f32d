"""The answer: result, sentences, figures, page, files."""

__all__: list[str] = []
