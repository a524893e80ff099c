"""Sentences, figures and the self-contained page."""
