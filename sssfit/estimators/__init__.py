"""What is learned from a stream, one value at a time: moments, sample counts, control variates, bias."""

from sssfit.estimators import bias as bias
from sssfit.estimators import control_variate as control_variate
from sssfit.estimators import conventions as conventions
from sssfit.estimators import count_prediction as count_prediction
from sssfit.estimators import in_frame as in_frame
from sssfit.estimators import moving as moving
from sssfit.estimators import policies as policies
from sssfit.estimators import sample_count as sample_count
from sssfit.estimators import stability as stability
