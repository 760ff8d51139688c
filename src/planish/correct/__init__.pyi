from .params import CorrectionRecord as CorrectionRecord
from .params import CorrectParams as CorrectParams
from .params import Cupping as Cupping
from .params import RingArtefact as RingArtefact
from .params import Trend as Trend
from .picture import write_picture as write_picture
from .volume import Corrected as Corrected
from .volume import correct_volume as correct_volume
