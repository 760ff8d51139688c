from .params import CorrectParams as CorrectParams
from .picture import write_picture as write_picture
from .record import Corrections as Corrections
from .record import Cupping as Cupping
from .record import Ring as Ring
from .record import Trend as Trend
from .volume import Corrected as Corrected
from .volume import correct_volume as correct_volume
