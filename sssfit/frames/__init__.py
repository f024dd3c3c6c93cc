"""Whole frames: what a renderer wrote, scattered, and how far that is from the truth."""

from sssfit.frames import adaptive as adaptive
from sssfit.frames import camera as camera
from sssfit.frames import compare as compare
from sssfit.frames import compose as compose
from sssfit.frames import exact as exact
from sssfit.frames import gbuffer as gbuffer
from sssfit.frames import mipmap as mipmap
from sssfit.frames import pixel_kernel as pixel_kernel
from sssfit.frames import points as points
from sssfit.frames import preview as preview
from sssfit.frames import procedural as procedural
from sssfit.frames import reference as reference
from sssfit.frames import render as render
from sssfit.frames import render_output as render_output
from sssfit.frames import scatter as scatter
from sssfit.frames import scene_profiles as scene_profiles
from sssfit.frames import sequence as sequence
from sssfit.frames import sequence_files as sequence_files
from sssfit.frames import sequence_ledger as sequence_ledger
from sssfit.frames import sequence_output as sequence_output
from sssfit.frames import split as split
from sssfit.frames import surface as surface
from sssfit.frames import taa as taa
from sssfit.frames import temporal as temporal
