"""Lookup tables: what they hold, writing them, and reading them back from files."""

from sssfit.tables.reading import LoadedTable as LoadedTable
from sssfit.tables.reading import load as load
from sssfit.tables.table import Axis as Axis
from sssfit.tables.table import Table as Table
