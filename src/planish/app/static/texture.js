/** Marks by the texture of map and image: searched, or put where a person says that the sheet lies. */

import { button, make, typeset } from "./dom.js";

/**
 * @import {Point} from "./geometry.js"
 * @import {App} from "./main.js"
 * @import {Mark, State} from "./store.js"
 */

/**
 * The button `Find by texture`, and one for each of the best places where none stands out; null for a linked run.
 * @param {App} app session of this window
 * @param {object} marks the tab of the marks
 * @param {() => Mark|null} marks.newest the newest mark that has one end only
 * @param {(point: Point) => void} marks.goTo shows a place of the image
 * @returns {HTMLElement|null}
 */
export function texture(app, marks) {
  if (app.session.linked) return null;
  const places = make("div", { class: "group", role: "group", "aria-label": "Best places" });
  const title =
    "Searches the image for the map by the texture that both show. A mark set in the image alone gives roughly where its middle lies.";
  const find = button("Find by texture", search, { disabled: app.readOnly, title });
  return make("div", { class: "group" }, find, places);

  /**
   * Search the image for the map, around the place of a mark that was set in the image alone.
   * @returns {Promise<void>}
   */
  async function search() {
    const mark = marks.newest();
    const near = mark && !mark.moving ? mark.fixed : null;
    places.replaceChildren();
    find.disabled = true;
    app.say("Searching by texture: about 10 to 100 seconds …");
    if (!(await take({ near }, "Marks found by texture"))) app.say("");
    find.disabled = app.readOnly;
  }

  /**
   * Ask the server for marks by texture; where no place stands out, offer the best ones.
   * @param {object} body where to look
   * @param {string} words what was done
   * @returns {Promise<State|null>} null where nothing was found
   */
  async function take(body, words) {
    return app.write(async () => {
      try {
        return await app.post("marks/texture", { ...body, layer: app.layer });
      } catch (error) {
        if (error.body?.places) places.replaceChildren("If you know the place: ", ...error.body.places.map(offered));
        throw error;
      }
    }, words);
  }

  /**
   * The button of a place that chance may reach as well.
   * @param {any} one place, as the server describes it
   * @returns {HTMLButtonElement}
   */
  function offered(one) {
    return button(typeset(one.text.replace(/: [\d.]+$/, "")), () => {
      marks.goTo(one.middle_um);
      void take({ place: one.place }, "Tiles put at the chosen place: nothing says how likely chance finds it");
    }, { title: "Looks for tiles of the texture there" });
  }
}
