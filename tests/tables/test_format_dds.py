"""DDS bytes as Microsoft's DDS programming guide lays them out."""

import struct

import numpy as np
import pytest

from sssfit.tables.formats import encode_table


def unsigned(data, offset):
    return struct.unpack_from("<I", data, offset)[0]


@pytest.mark.parametrize("dimensions, width, height", [(1, 7, 1), (2, 3, 7)])
def test_header(make_table, dimensions, width, height):
    data = encode_table(make_table(dimensions), "dds")[".dds"]
    assert data[:4] == b"DDS "
    # DDS_HEADER begins at offset 4.
    assert unsigned(data, 4) == 124  # dwSize
    # dwFlags: DDSD_CAPS, DDSD_HEIGHT, DDSD_WIDTH, DDSD_PITCH and DDSD_PIXELFORMAT.
    assert unsigned(data, 8) == 0x0000100F
    assert unsigned(data, 12) == height
    assert unsigned(data, 16) == width
    assert unsigned(data, 20) == width * 8  # dwPitchOrLinearSize, 64 bits a texel
    assert unsigned(data, 24) == 0  # dwDepth
    assert unsigned(data, 28) == 0  # dwMipMapCount
    assert data[32:76] == bytes(44)  # dwReserved1
    # DDS_PIXELFORMAT begins at offset 76.
    assert unsigned(data, 76) == 32  # dwSize
    assert unsigned(data, 80) == 0x4  # dwFlags: DDPF_FOURCC
    assert data[84:88] == b"DX10"  # dwFourCC
    assert data[88:108] == bytes(20)  # bit count and masks
    assert unsigned(data, 108) == 0x1000  # dwCaps: DDSCAPS_TEXTURE
    assert data[112:128] == bytes(16)  # dwCaps2 to dwReserved2
    # DDS_HEADER_DXT10 begins at offset 128.
    assert unsigned(data, 128) == 10  # DXGI_FORMAT_R16G16B16A16_FLOAT
    assert unsigned(data, 132) == 3  # D3D10_RESOURCE_DIMENSION_TEXTURE2D
    assert unsigned(data, 136) == 0  # miscFlag
    assert unsigned(data, 140) == 1  # arraySize
    assert unsigned(data, 144) == 0  # miscFlags2: alpha mode unknown
    assert len(data) == 148 + width * height * 8


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_texels(make_table, channels):
    table = make_table(2, channels)
    data = encode_table(table, "dds")[".dds"]
    texels = np.frombuffer(data[148:], dtype="<f2").reshape(7, 3, 4)
    np.testing.assert_array_equal(texels[..., :channels], table.values.astype(np.float16))
    for channel in range(channels, 4):
        assert (texels[..., channel] == (1.0 if channel == 3 else 0.0)).all()
