// What runs in the browser. Each part after a line of slashes and a name is the body of a callback.
//// show: draws an instant of the slipper
const f = frames.data
if (!f.x) return
const k = Math.min(time.value, f.x.length - 1)
const row = (key) => {
  const all = f[key], n = all.length / f.x.length
  return Array.from({length: n}, (_, i) => all[k * n + i])
}
for (const [end, patch, dots] of [["front", front, front_dots], ["rear", rear, rear_dots]]) {
  patch.data = {x: row(end + "_corner_y"), y: row(end + "_corner_z")}
  const at = {x: row(end + "_point_y"), y: row(end + "_point_z"), tip_x: row(end + "_tip_y"), tip_y: row(end + "_tip_z")}
  dots.data = {...dots.data, ...at, alpha: row(end + "_force").map((force) => force > 0 ? 1 : 0)}
}
cursor.data = {x: [f.x[k]]}
//// play
clearInterval(window.slipper_timer)
if (toggle.active) window.slipper_timer = setInterval(() => { time.value = (time.value + 1) % (time.end + 1) }, 50)
toggle.label = toggle.active ? "Pause" : "Play"
//// copy
const old_way = () => {
  const area = document.createElement("textarea")
  area.value = texts.data.python[0]
  document.body.appendChild(area)
  area.select()
  document.execCommand("copy")
  area.remove()
}
if (navigator.clipboard) navigator.clipboard.writeText(texts.data.python[0]).catch(old_way)
else old_way()
//// save: the scene as a file
const link = document.createElement("a")
link.href = URL.createObjectURL(new Blob([texts.data.toml[0]], {type: "application/octet-stream"}))
link.download = "scene.toml"
link.click()
