"""A PyBullet client: poses go in and come out, contacts are told from the side of the body that was asked about."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolkit.geometry import make_transform
from toolkit.sim.bullet import pybullet
from toolkit.sim.client import BASE, Client
from toolkit.sim.robots import ROBOTS

HALF = np.array([0.02, 0.03, 0.04])
numbers = st.floats(-3, 3, allow_subnormal=False)


@pytest.fixture(scope="module")
def client():
    with closing(Client()) as client:
        yield client


def add_box(client, *place):
    shape = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=HALF.tolist())
    body = client.createMultiBody(1, shape)
    client.place(body, make_transform(np.eye(3), np.array(place)))
    return body


@given(place=st.tuples(numbers, numbers, numbers), turn=st.tuples(numbers, numbers, numbers))
def test_a_body_is_where_it_was_placed(client, place, turn):
    T = make_transform(Rotation.from_rotvec(turn).as_matrix(), np.array(place))
    body = client.createMultiBody(1)
    client.place(body, T)
    np.testing.assert_allclose(client.pose(body), T, atol=1e-9)
    client.removeBody(body)


def test_contacts_are_told_from_the_side_of_either_body():
    with closing(Client()) as client:
        table = client.add_plane()
        body = add_box(client, 0, 0, HALF[2] - 0.001)
        client.performCollisionDetection()
        for asked, other in ((body, table), (table, body)):
            contacts = client.contacts(asked)
            assert contacts
            assert {(contact.link, contact.other, contact.other_link) for contact in contacts} == {(BASE, other, BASE)}
            assert min(contact.distance for contact in contacts) == pytest.approx(-0.001, abs=2e-4)
            assert client.contacts(asked, other) == contacts
        client.ignore(body, table)
        client.performCollisionDetection()
        assert client.contacts(body) == []


def test_what_stands_on_the_table_presses_with_its_weight():
    with closing(Client()) as client:
        client.setGravity(0, 0, -9.81)
        table = client.add_plane()
        body = add_box(client, 0, 0, HALF[2])
        for _ in range(240):
            client.stepSimulation()
        assert sum(contact.force for contact in client.contacts(body, table)) == pytest.approx(9.81, rel=0.02)


def test_gaps_are_measured_up_to_where_one_looks():
    with closing(Client()) as client:
        one, other = add_box(client, 0, 0, 0), add_box(client, 0.1, 0, 0)
        assert min(contact.distance for contact in client.closest(one, other, 0.1)) == pytest.approx(0.06, abs=1e-6)
        assert client.closest(one, other, 0.05) == []


def test_rays_meet_what_lies_highest_and_belongs_to_the_bodies_asked_for():
    with closing(Client()) as client:
        low, high, aside = (add_box(client, *place) for place in ((0, 0, 0.04), (0, 0, 0.2), (1, 0, 0.04)))
        points = np.zeros((5, 3))
        assert client.under(points, [low, high, aside]) == 1
        client.setCollisionFilterGroupMask(high, BASE, 64, -1)
        assert client.under(points, [low, high, aside], groups=-1 ^ 64) == 0
        assert client.under(points, [aside]) is None


def test_joints_and_links_have_the_names_of_the_description():
    with closing(Client()) as client:
        body = client.loadURDF(str(ROBOTS["panda"].urdf()), useFixedBase=True)
        joints = client.joints(body)
        assert [joint.name for joint in joints][:7] == [f"panda_joint{i}" for i in range(1, 8)]
        assert [joint.parent for joint in joints][:7] == list(range(-1, 6))
        assert all(joint.lower < joint.upper for joint in joints[:7])
        np.testing.assert_array_equal(joints[0].axis, [0, 0, 1])
        client.resetJointState(body, 3, -1.0)
        np.testing.assert_allclose(client.angles(body, [2, 3]), [0, -1.0])
        state = client.link(body, 0)
        np.testing.assert_allclose(state.T_world_link, make_transform(np.eye(3), np.array([0, 0, 0.333])), atol=1e-6)
        assert not np.allclose(state.T_world_mass, state.T_world_link)
