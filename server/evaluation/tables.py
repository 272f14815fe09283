"""An evaluation as tables in the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from server.evaluation.report import FollowerReport, LeaderReport, RouteReport, Spread


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"


def _spread(value: Spread, digits: int) -> str:
    return " / ".join(_number(v, digits) for v in (value.median, value.p90, value.max))


def _leader_table(leader: LeaderReport) -> Table:
    table = Table(title=f"Leader {leader.name}", show_header=False, title_justify="left")
    rate = leader.build_seconds / leader.video_seconds if leader.video_seconds > 0 else None
    rows = [
        ("status", leader.status),
        ("frames, tracked", f"{leader.frames}, {_percent(leader.tracked_fraction)}"),
        ("keyframes, landmarks", f"{leader.keyframes}, {leader.landmarks}"),
        ("ATE RMSE", f"{_number(leader.ate_rmse_m)} m = {_number(leader.ate_percent_of_path, 2)} % of path"),
        ("path", f"{leader.path_length_m:.1f} m"),
        ("build", f"{leader.build_seconds:.1f} s = {_number(rate, 2)} x video"),
        ("map, peak memory", f"{leader.map_bytes / 1e6:.2f} MB, {leader.peak_rss_bytes / 1e6:.0f} MB"),
    ]
    if leader.camera_offset_deg > 0:
        rows.append(
            ("camera offset", f"{leader.camera_offset_deg:.2f}°, {100 * leader.camera_offset_m:.1f} cm")
        )
    for row in rows:
        table.add_row(*row)
    return table


def _false_fixes(follower: FollowerReport) -> str:
    return f"[bold red]{follower.false_fixes}" if follower.false_fixes else "[green]0"


def _follower_table(followers: tuple[FollowerReport, ...]) -> Table:
    table = Table(title="Followers, relative to the route", title_justify="left")
    table.add_column("")
    for follower in followers:
        table.add_column(follower.name, justify="right")
    rows: list[tuple[str, list[str]]] = [
        ("frames (off the route)", [f"{f.frames} ({f.off_route_frames})" for f in followers]),
        ("relocalized on the route", [_percent(f.relocalized_fraction) for f in followers]),
        ("position m: median / p90 / max", [_spread(f.position_error_m, 3) for f in followers]),
        ("rotation °: median / p90 / max", [_spread(f.rotation_error_deg, 2) for f in followers]),
        ("absolute m: median / p90 / max", [_spread(f.absolute_error_m, 3) for f in followers]),
        ("false fixes", [_false_fixes(f) for f in followers]),
        ("fixes off the route", [str(f.off_route_fixes) for f in followers]),
        ("hint agreement", [_number(f.hint_agreement) for f in followers]),
        ("  always straight", [_number(f.hint_always_straight) for f in followers]),
        ("arrived", ["yes" if f.arrived else "no" for f in followers]),
        ("  told so too early", [str(f.premature_arrivals) for f in followers]),
        ("latency ms: p50 / p95 / p99", [_latency(f) for f in followers]),
        ("refusals", [_refusals(f) for f in followers]),
    ]
    if any(f.wrong_building for f in followers):
        rows.insert(0, ("wrong building", ["yes" if f.wrong_building else "" for f in followers]))
    for title, cells in rows:
        table.add_row(title, *cells)
    return table


def _latency(follower: FollowerReport) -> str:
    latency = follower.latency_ms
    return " / ".join(_number(v, 1) for v in (latency.p50, latency.p95, latency.p99))


def _refusals(follower: FollowerReport) -> str:
    return "\n".join(f"{count} {reason}" for reason, count in follower.refusals.items()) or "none"


def print_report(report: RouteReport, console: Console) -> None:
    """Print the leader's figures and the followers side by side."""
    console.print(_leader_table(report.leader))
    if report.followers:
        console.print(_follower_table(report.followers))
