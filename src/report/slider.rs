//! Two pictures on top of each other, with a divider to drag.

/// The section of the page. The choices of both sides are `<option>` elements whose values are the ids of `<img>` elements elsewhere on the page.
pub fn section((width, height): (usize, usize), left: &str, right: &str) -> String {
    format!(
        "<section>\n<h2>Side by side</h2>\n<div class=\"slider\" id=\"slider\">\n<div class=\"controls\">\n\
         <label>Left <select id=\"left\">{left}</select></label>\n<label>Right <select id=\"right\">{right}</select></label>\n\
         <label>Zoom <select id=\"zoom\"><option value=\"1\">fit</option><option value=\"2\">2\u{d7}</option>\
         <option value=\"4\">4\u{d7}</option><option value=\"8\">8\u{d7}</option><option value=\"16\">16\u{d7}</option></select></label>\n\
         <label class=\"check\"><input type=\"checkbox\" id=\"pixelated\" checked> Sharp pixels</label>\n</div>\n\
         <div class=\"stage\" id=\"stage\" tabindex=\"0\" role=\"group\" aria-label=\"Images; arrow keys move the zoomed part\" \
         style=\"aspect-ratio:{width}/{height};--ratio:{}\">\n\
         <img id=\"after\" alt=\"\" draggable=\"false\">\n<img id=\"before\" alt=\"\" draggable=\"false\">\n\
         <div class=\"divider\" id=\"divider\" aria-hidden=\"true\"></div>\n\
         <p class=\"tag tag-left\" id=\"tag-left\" aria-live=\"polite\"></p>\n\
         <p class=\"tag tag-right\" id=\"tag-right\" aria-live=\"polite\"></p>\n</div>\n\
         <input type=\"range\" id=\"position\" min=\"0\" max=\"100\" step=\"0.5\" value=\"50\" aria-label=\"Position of the divider\">\n\
         <p class=\"note\">Drag on the picture, or use the arrow keys on the bar below it. When zoomed in, drag the \
         divider, and the picture to move it.</p>\n</div>\n\
         <noscript><p class=\"note\">The slider needs JavaScript; all images are below.</p></noscript>\n</section>\n",
        width as f64 / height as f64,
    )
}
