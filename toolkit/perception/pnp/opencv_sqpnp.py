"""SQPnP, by OpenCV."""

from __future__ import annotations

import cv2

from toolkit.perception.pnp.solving.opencv import OpenCVPnP


class OpenCVSQPnP(OpenCVPnP):
    """SQPnP: sequential quadratic programming over rotations (Terzakis, Lourakis, ECCV 2020)."""

    name = "opencv_sqpnp"
    flag = cv2.SOLVEPNP_SQPNP
