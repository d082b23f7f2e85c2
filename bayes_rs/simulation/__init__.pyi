from .boxes import BoxGrid as BoxGrid
from .load_box import box_stresses as box_stresses
from .load_box import export_box as export_box
from .virtual import simulate as simulate
