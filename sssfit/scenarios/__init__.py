"""Small worlds with exact answers: where sample counts are simulated, compared and tuned."""

from sssfit.scenarios import batch_mean as batch_mean
from sssfit.scenarios import circle as circle
from sssfit.scenarios import driver as driver
from sssfit.scenarios import light as light
from sssfit.scenarios import line as line
from sssfit.scenarios import measure as measure
from sssfit.scenarios import tune as tune
