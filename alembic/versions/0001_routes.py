"""Routes: what is uploaded, how its build stands, what came of it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "routes",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("owner", sa.String(128), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("start_label", sa.String(200), nullable=False),
        sa.Column("destination_label", sa.String(200), nullable=False),
        sa.Column("measured_length_m", sa.Float(), nullable=True),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("camera", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("video_key", sa.String(256), nullable=True),
        sa.Column("video_bytes", sa.BigInteger(), nullable=True),
        sa.Column("map_key", sa.String(256), nullable=True),
        sa.Column("path_key", sa.String(256), nullable=True),
        sa.Column("build_stage", sa.String(32), nullable=True),
        sa.Column("build_fraction", sa.Float(), nullable=False),
        sa.Column("build_attempt", sa.Integer(), nullable=False),
        sa.Column("failure_reason", sa.String(64), nullable=True),
        sa.Column("failure_detail", sa.Text(), nullable=True),
        sa.Column("report", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("map_summary", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "state IN ('created', 'uploaded', 'building', 'ready', 'failed')", name=op.f("ck_routes_state")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_routes")),
    )
    op.create_index(op.f("ix_routes_owner_created_at_id"), "routes", ["owner", "created_at", "id"])
    op.create_index(op.f("ix_routes_state"), "routes", ["state"])


def downgrade() -> None:
    op.drop_table("routes")
