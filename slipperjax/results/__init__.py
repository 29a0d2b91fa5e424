"""Results: the methods of all results, and the texts, tables and pictures of each kind."""

from .result import AbstractResult as AbstractResult
