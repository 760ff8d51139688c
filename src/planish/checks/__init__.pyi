from .exposure import exposure_check as exposure_check
from .scan import check_scan as check_scan
