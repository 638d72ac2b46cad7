"""A checkerboard photographed through distorting lenses is where OpenCV projects it, in colour and labels.

The image of 14 x 10 tilted squares, divided by that of a white board, gives the corners to sub-pixels, and
OpenCV projects them with the same intrinsics; it counts from the first pixel's centre, which is (.5, .5)
here. The finder errs by up to .035 pixels on an exact image and .060 with 16 samples: the worst of 117
corners must be below .1, the mean below .02. Half a pixel or a p1 wrong by .0002 exceeds that.
"""

from dataclasses import astuple, replace

import cv2
import numpy as np
import pytest
import trimesh
from bodies import axis_camera, body, even_lamp
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from pepperscene.camera import Distortion, load_lens
from pepperscene.classes import OrganClass
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import lambertian_surface
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene
from pepperscene.spectra import read_spectrum

SQUARE, COLUMNS, ROWS, BORDER = 0.045, 14, 10, 0.03  # metres; squares; metres of white around
FOCAL = 4.16e-3 / 9e-6  # pixels: 4.16 mm over two photosites of 4.5 um
LED = read_spectrum("light/houser2013_cool_white_led", "slide_4_lumileds_cool_white")
TILT = trimesh.transformations.euler_matrix(np.radians(10.0), np.radians(20.0), np.radians(4.0))[:3, :3]
POSITION = np.array([-0.06, 0.0, 0.48])
LENSES = {
    "typical": load_lens("lensagon_cmfa0420nd_typical_distortion").distortion,
    "strong": Distortion(k1=-0.25, k2=0.08, p1=3e-3, p2=-2e-3, k3=-0.005),
}


def rectangles(bounds, surface, organ_class):
    """Rectangles `(k, 4)` of x0, y0, x1, y1 in the board's plane as one mesh that faces the camera."""
    corners = [[[a, b, 0.0], [c, b, 0.0], [c, d, 0.0], [a, d, 0.0]] for a, b, c, d in bounds]
    faces = [[4 * k + i for i in three] for k in range(len(bounds)) for three in ((0, 2, 1), (0, 3, 2))]
    flat = trimesh.Trimesh(np.reshape(corners, (-1, 3)), faces, process=False)
    return body(flat, surface, organ_class).moved(TILT, POSITION)


def board():
    """The board's mesh: white of class LEAF, black of class STEM."""
    x = (np.arange(COLUMNS + 1) - COLUMNS / 2) * SQUARE
    y = (np.arange(ROWS + 1) - ROWS / 2) * SQUARE
    squares = [
        [(x[i], y[j], x[i + 1], y[j + 1]) for j in range(ROWS) for i in range(COLUMNS) if (i + j) % 2 == odd]
        for odd in (0, 1)
    ]
    left, top, right, bottom = x[0], y[0], x[-1], y[-1]
    margin = [
        (left - BORDER, top - BORDER, right + BORDER, top),
        (left - BORDER, bottom, right + BORDER, bottom + BORDER),
        (left - BORDER, top, left, bottom),
        (right, top, right + BORDER, bottom),
    ]
    white = rectangles(squares[0] + margin, "white", OrganClass.LEAF)
    return concatenate_meshes([white, rectangles(squares[1], "black", OrganClass.STEM)])


def board_corners(margin=0):
    """`(k, 3)` corners of the squares in the world, row by row, without the `margin` outermost rings."""
    x = (np.arange(margin, COLUMNS + 1 - margin) - COLUMNS / 2) * SQUARE
    y = (np.arange(margin, ROWS + 1 - margin) - ROWS / 2) * SQUARE
    flat = np.stack([*np.meshgrid(x, y), np.zeros((y.size, x.size))], -1).reshape(-1, 3)
    return flat @ TILT.T + POSITION


def projected(points, distortion):
    """`(k, 2)` pixel coordinates by OpenCV, pixel centres at +.5."""
    matrix = np.array([[FOCAL, 0, 400 - 0.5], [0, FOCAL, 300 - 0.5], [0, 0, 1]])
    still = np.zeros(3)
    return cv2.projectPoints(points, still, still, matrix, np.array(astuple(distortion)))[0][:, 0] + 0.5


@pytest.fixture(scope="module", params=["strong", pytest.param("typical", marks=pytest.mark.long)])
def photograph(request):
    """(distortion, white fraction of each pixel `(600, 800)`, class of each pixel)."""
    camera = axis_camera(flash=even_lamp(LED))
    distortion = LENSES[request.param]
    camera = replace(camera, lens=replace(camera.lens, distortion=distortion))
    mesh, white = board(), lambertian_surface("white", 0.9)
    frame, blank = (
        Renderer(assemble_scene(mesh, {"white": white, "black": black})).render(
            camera, ["electrons", "class"], "standard", seed=1
        )
        for black in (lambertian_surface("black", 0.0), replace(white, name="black"))
    )
    even = blank["electrons"].sum(-1)
    whiteness = np.where(even > 0, frame["electrons"].sum(-1) / np.maximum(even, 1e-6), 0.0)
    return distortion, whiteness, frame["class"]


def found_corners(whiteness):
    """`(117, 2)` pixel coordinates, row by row from the upper left, pixel centres at +.5."""
    grey = np.clip(np.rint(gaussian_filter(whiteness, 1.5) * 255.0), 0, 255).astype(np.uint8)
    found, corners = cv2.findChessboardCornersSB(
        grey, (COLUMNS - 1, ROWS - 1), flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    )
    assert found
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    corners = cv2.cornerSubPix(grey, corners, (8, 8), (-1, -1), stop).reshape(-1, 2)
    # The finder may start at any end of the board.
    corners = corners if corners[0, 1] < corners[-1, 1] else corners[::-1]
    return corners + 0.5


def test_corners_match_opencv(photograph):
    distortion, whiteness, _ = photograph
    corners = board_corners(margin=1)
    expected = projected(corners, distortion)
    error = found_corners(whiteness) - expected
    # The distortion matters: without it the board's border would be many pixels away.
    pinhole = projected(corners, Distortion())
    assert np.linalg.norm(pinhole - expected, axis=1).max() > 10.0
    assert np.linalg.norm(error, axis=1).max() < 0.1
    assert np.abs(error.mean(0)).max() < 0.02


def test_edges_of_colour_match_edges_of_labels(photograph):
    distortion, whiteness, classes = photograph
    # Beyond the image's border the board's edge, with half-covered pixels, cannot be seen.
    on_board = minimum_filter(classes > 0, 5, mode="constant")
    white = classes == OrganClass.LEAF
    # Away from edges, light and label agree.
    even = on_board & (maximum_filter(white, 3) == minimum_filter(white, 3))
    assert np.abs(whiteness - white)[even].max() < 0.01
    # On an edge the label is that of the pixel's centre, which has more than half of the light except for the
    # samples' error (.033 measured). Pixels in which four squares meet are left out.
    edge = on_board & ~even
    u, v = np.meshgrid(np.arange(800) + 0.5, np.arange(600) + 0.5)
    for x, y in projected(board_corners(), distortion):
        edge &= np.hypot(u - x, v - y) > 1.5
    assert edge.sum() > 5000
    error = np.abs(whiteness - white)[edge]
    assert error.max() < 0.5 + 6 * 0.033
    assert (error > 0.5 + 2 * 0.033).mean() < 0.002
    # The edges' mean shift in each quarter: light minus label is the step times the shift. A label's edge is
    # known to a pixel, and neighbours on a straight edge agree, so .05 pixels can be resolved.
    for quarter in (np.s_[:300, :400], np.s_[:300, 400:], np.s_[300:, :400], np.s_[300:, 400:]):
        slopes = np.stack([slope[quarter][edge[quarter]] for slope in np.gradient(white * 1.0)], -1)
        shift, *_ = np.linalg.lstsq(slopes, (white - whiteness)[quarter][edge[quarter]], rcond=None)
        assert np.abs(shift).max() < 0.05
