"""EPnP, by OpenCV."""

from __future__ import annotations

import cv2

from toolkit.perception.pnp.solving.opencv import OpenCVPnP


class OpenCVEPnP(OpenCVPnP):
    """EPnP: four virtual control points (Lepetit, Moreno-Noguer, Fua, IJCV 2009)."""

    name = "opencv_epnp"
    flag = cv2.SOLVEPNP_EPNP
