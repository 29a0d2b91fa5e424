"""Results: what every answer can do, and the words, tables and pictures of each kind."""

from .result import AbstractResult as AbstractResult
