import { trace } from "./draw.js";
export function drawReach(context, tint, px, map) {
    const path = new Path2D(), at = map.points_m.map(px);
    for (const [i, j, k] of map.triangles) {
        const [a, b, c] = [at[i], at[j], at[k]];
        const turned = (b[0] - a[0]) * (c[1] - a[1]) < (b[1] - a[1]) * (c[0] - a[0]);
        path.moveTo(...a);
        path.lineTo(...(turned ? c : b));
        path.lineTo(...(turned ? b : c));
        path.closePath();
    }
    context.fillStyle = tint.blue;
    context.globalAlpha = 0.11;
    context.fill(path);
    context.globalAlpha = 1;
    for (const { limit, line_m } of map.edges)
        drawEdge(context, tint, px, line_m, limit);
}
export function drawEdge(context, tint, px, line, limit) {
    const stable = limit !== "stability";
    context.strokeStyle = stable ? tint.blue : tint.orange;
    context.lineWidth = stable ? 1.2 : 2;
    context.setLineDash(stable ? [] : [6, 5]);
    trace(context, line.map(px));
    context.stroke();
    context.setLineDash([]);
}
