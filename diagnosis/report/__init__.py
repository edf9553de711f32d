"""The answer: result, sentences, figures, page, files."""
