from .scan import check_scan as check_scan
