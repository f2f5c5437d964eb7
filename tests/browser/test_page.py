"""The page in Chromium, before a running cell: what it shows, what it drives, and how it stops."""

import numpy as np
import pytest

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.timeout(300)]

Q = "Array.from(deltaq.live.frame.robots[deltaq.live.indexOf('gr')].q)"
AT_REST = (
    "(() => { const {q, rest} = deltaq.live.frame?.robots[deltaq.live.indexOf('gr')] ?? {};"
    " return q?.every((value, k) => Math.abs(value - rest[k]) < 1e-4); })()"
)


def take_control(page):
    """Take gr, which is held after a stop, and drive it joint by joint."""
    page.locator("[data-robot=gr]").click()
    page.wait_for_function("deltaq.live.locked('gr') === ''")
    if page.evaluate("deltaq.live.robot('gr').phase") == "held":
        for robot in ("fr", "gr"):
            page.evaluate("robot => deltaq.live.send('reset', {robot})", robot)
        page.wait_for_function("deltaq.live.robot('gr').phase !== 'held'")
    page.get_by_role("button", name="Take control").click()
    page.wait_for_function("deltaq.live.robot('gr').lease.mine && deltaq.live.robot('gr').mode")
    page.evaluate(
        "deltaq.live.send('mode', {robot: 'gr', mode: 'joint'})"
    )  # whatever it was driven in before
    page.wait_for_function("deltaq.live.robot('gr').mode === 'joint'")


def hold_until_it_moves(page):
    """Press and hold a jog button; the button is pressed anew if the picture was old for a moment.

    Tests share the cell: each turns A6 away from the limit that it is nearer to.
    """
    before = page.evaluate(Q)
    way, wish = ("minus", -0.2) if before[-1] > 0 else ("plus", 0.2)
    page.get_by_role("button", name=f"A6 {way}, hold to move").hover()
    page.mouse.down()
    page.evaluate(
        """wish => { window.pressing = setInterval(() => deltaq.wish.isActive
             || deltaq.wish.hold("test", {[deltaq.driven.length() - 1]: wish}), 50); }""",
        wish,
    )
    page.wait_for_function(
        f"before => {Q}.some((value, k) => Math.abs(value - before[k]) > 0.02)", arg=before
    )


# colours of the picture on the page, every tenth pixel, the page's own canvas and not what WebGL drew into
PICTURE = """() => {
    const {canvas} = deltaq.stage;
    const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return Array.from({length: Math.floor(data.length / 40)}, (_, k) => Array.from(data.slice(40 * k, 40 * k + 3)));
}"""


@pytest.mark.nightly
def test_a_picture_drawn_off_the_page_is_shown_and_updated(opened):
    page = opened()
    page.wait_for_function("deltaq.stage.isFinest()")
    # a canvas of WebGL on the page would hold up whatever the page has to hear, a press of STOP too
    assert not page.evaluate("deltaq.stage.renderer.domElement.isConnected")
    assert page.evaluate("deltaq.stage.canvas.isConnected")
    before = np.array(page.evaluate(PICTURE))
    assert len(np.unique(before, axis=0)) > 100  # a room with robots in it, not a blank
    page.locator("[data-part=views] button", has_text="Top").click()
    page.wait_for_function("deltaq.stage.camera.position.z > 3 && deltaq.stage.isFinest()")
    after = np.array(page.evaluate(PICTURE))
    assert after.shape == before.shape
    assert np.mean(np.any(np.abs(after - before) > 20, axis=1)) > 0.05


# the camera's picture as the page shows it, coarsely, however fine it was drawn
INSET = """() => {
    const {canvas} = deltaq.stage;
    const [outer, inner] = [canvas, deltaq.picture.box].map((element) => element.getBoundingClientRect());
    const ratio = canvas.width / outer.width;
    const part = [inner.left - outer.left, inner.top - outer.top, inner.width, inner.height]
        .map((length) => ratio * length);
    const pen = Object.assign(document.createElement("canvas"), {width: 24, height: 16}).getContext("2d");
    pen.drawImage(canvas, ...part, 0, 0, 24, 16);
    return Array.from(pen.getImageData(0, 0, 24, 16).data);
}"""
# as of a picture that left it as it was, while that is on the page
KEPT = f"""() => new Promise((kept) => {{
    const look = () => deltaq.picture._isSkipped && !deltaq.stage._isUnseen ? kept(({INSET})()) : setTimeout(look, 1);
    look();
}})"""


@pytest.mark.nightly
def test_the_camera_picture_stays_when_an_update_omits_it(opened):
    page = opened()
    page.wait_for_function("deltaq.stage.isFinest()")
    still = np.array(page.evaluate(INSET))
    take_control(page)
    hold_until_it_moves(page)
    kept = np.array([page.evaluate(KEPT) for _ in range(5)])
    page.evaluate("clearInterval(pressing), deltaq.wish.release('test')")
    page.mouse.up()
    # the wrist turns in it; all else is as it was
    assert np.median(np.abs(kept - still), axis=1).max() < 6
    page.wait_for_function(f"{AT_REST} && deltaq.stage.isFinest()")
    turned = np.array(page.evaluate(INSET))
    assert np.abs(turned - still).max() > 6
    assert np.median(np.abs(turned - still)) < 6


@pytest.mark.nightly
def test_drawing_resumes_after_a_lost_graphics_context(opened):
    page = opened()
    page.wait_for_function("deltaq.stage.isFinest()")
    page.evaluate("""async () => {
        const drawn = deltaq.stage.renderer.domElement;
        const heard = (kind) => new Promise((done) => drawn.addEventListener(kind, done, {once: true}));
        const hardware = deltaq.stage.renderer.getContext().getExtension("WEBGL_lose_context");
        const lost = heard("webglcontextlost");
        deltaq.stage.ask();
        hardware.loseContext();
        await lost;
        const back = heard("webglcontextrestored");
        setTimeout(() => hardware.restoreContext());
        await back;
        deltaq.stage.enter(false);
    }""")
    page.wait_for_function("deltaq.stage.isFinest()")
    assert len(np.unique(np.array(page.evaluate(PICTURE)), axis=0)) > 100


@pytest.mark.parametrize("way", ["pointer", pytest.param("escape", marks=pytest.mark.nightly)])
def test_stop_brings_a_driven_robot_to_rest_and_shows_it(opened, way):
    page = opened()
    take_control(page)
    hold_until_it_moves(page)
    if way == "pointer":
        page.evaluate(
            "document.querySelector('[data-part=stop]').dispatchEvent(new PointerEvent('pointerdown'))"
        )
    else:
        page.keyboard.press("Escape")
    page.wait_for_function("deltaq.stop.state === 'at_rest'")
    assert page.locator("[data-part=stop-answer]").text_content() == "every robot is at rest"
    assert page.evaluate("deltaq.live.robot('gr').reason") == "operator_stop"
    page.wait_for_function(AT_REST)  # pictures come by themselves, and one may be on its way


@pytest.mark.nightly
def test_reloading_the_page_in_motion_keeps_name_and_control_and_stops_the_robot(opened, served_cell):
    page = opened()
    name = page.get_by_label("Your name")
    name.fill("Anna")
    name.press("Enter")
    page.wait_for_function("deltaq.live.hello.client === 'Anna' && deltaq.live.status?.hli")
    take_control(page)
    hold_until_it_moves(page)
    page.reload()
    page.wait_for_selector("[data-ready=true]", state="attached")
    page.wait_for_function(f"deltaq.live.robot('gr')?.lease.mine && {AT_REST}")
    assert page.evaluate("deltaq.live.hello.client") == "Anna"
    assert page.evaluate("deltaq.wish.isActive") is False
    hold_until_it_moves(page)
    page.mouse.up()
    page.evaluate("clearInterval(pressing), deltaq.wish.releaseAll()")


@pytest.mark.nightly
def test_a_lost_connection_locks_the_page_and_reconnection_sends_nothing(opened):
    line = {"cut": False, "sent": []}

    def route(websocket):
        server = websocket.connect_to_server()

        def to_server(message):
            if not line["cut"]:
                line["sent"].append(message)
                server.send(message)

        websocket.on_message(to_server)
        server.on_message(lambda message: None if line["cut"] else websocket.send(message))

    page = opened(lambda page: page.route_web_socket("**/live**", route))
    take_control(page)
    hold_until_it_moves(page)
    line["cut"] = True
    page.wait_for_function("document.documentElement.dataset.stale === 'true' && !deltaq.wish.isActive")
    page.evaluate("clearInterval(window.pressing)")
    assert page.evaluate("deltaq.live.cannotDrive('gr')") != ""
    assert page.evaluate("getComputedStyle(document.querySelector('[data-part=cover]')).display") == "block"
    line["sent"].clear()
    line["cut"] = False
    page.wait_for_function("document.documentElement.dataset.stale === 'false'")
    page.wait_for_function(AT_REST)
    assert not [message for message in line["sent"] if '"jog"' in message]


@pytest.mark.nightly
def test_a_second_operator_asks_for_the_robot_gets_it_and_drives_it(opened):
    first, second = opened(), opened()
    take_control(first)
    second.locator("[data-robot=gr]").click()
    name = first.evaluate("deltaq.live.hello.client")
    second.wait_for_function("name => deltaq.live.robot('gr').lease.holder === name", arg=name)
    assert name in second.locator(".lease").text_content()
    assert second.evaluate("deltaq.live.cannotDrive('gr')") != ""
    second.get_by_role("button", name="Ask for it").click()
    first.get_by_role("button", name="Hand over").click()
    second.wait_for_function("deltaq.live.robot('gr').lease.mine")
    first.wait_for_function("!deltaq.live.robot('gr').lease.mine")
    hold_until_it_moves(second)
    second.mouse.up()
    second.evaluate("clearInterval(pressing), deltaq.wish.releaseAll()")
    second.wait_for_function(AT_REST)
