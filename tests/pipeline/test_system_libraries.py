"""A missing system library is named with the package that brings it."""

from pipeline.system_libraries import missing_libraries


def test_nothing_is_said_where_all_libraries_are_there():
    assert missing_libraries({"libc.so.6": ("libc6", "everything")}) == []


def test_a_missing_library_is_named_with_its_package():
    (sentence,) = missing_libraries({"libnowhere.so.9": ("libnowhere9", "Open3D")})
    assert "libnowhere.so.9 is missing" in sentence
    assert "apt-get install -y --no-install-recommends libnowhere9" in sentence
