"""Stores: results of sweeps on disk, made by one machine or many, resumed after anything."""

from .archive import open_store as open_store
from .locks import StoreInUse as StoreInUse
from .processes import processes as processes
from .reuse import refined as refined
from .stored import COPIES as COPIES
from .stored import storable as storable
from .stored import stored as stored
from .target import Store as Store
from .target import check_share as check_share
from .target import store_of as store_of
from .tasks import WorkerLost as WorkerLost
from .tiles import Tiling as Tiling
from .tiles import tiling as tiling
from .upkeep import StoreStatus as StoreStatus
from .upkeep import check_store as check_store
from .upkeep import merge_stores as merge_stores
from .upkeep import store_status as store_status
