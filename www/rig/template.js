// What the rig view is made of.

export const TEMPLATE = `
    <section class="card rig-bar" aria-label="Connection">
      <select class="rig-port" aria-label="Arm"></select>
      <button type="button" class="button primary rig-connect">Connect</button>
      <span class="rig-state" role="status">Not connected</span>
      <button type="button" class="rig-stop" title="Stops at once: hold and reset, past everything queued (Escape)">STOP</button>
      <p class="rig-said" aria-live="assertive"></p>
    </section>
    <section class="card rig-arm" aria-labelledby="rig-arm-title">
      <h2 id="rig-arm-title">Arm</h2>
      <div class="rig-dome"></div>
      <dl class="rig-read"><dt>State</dt><dd class="rd-state">–</dd><dt>Azimuth</dt><dd class="rd-azimuth">–</dd><dt>Slant</dt><dd class="rd-slant">–</dd><dt>Position</dt><dd class="rd-trust">–</dd><dt>LED</dt><dd class="rd-led">–</dd></dl>
      <div class="row"><button type="button" class="button" data-do="home">Home</button><button type="button" class="button" data-do="unlock">Unlock</button><button type="button" class="button" data-do="here" hidden title="This board has no homing: put the arm to azimuth 0, slant 0 by hand, then say so">Here is 0°, 0°</button><button type="button" class="button" data-do="hold">Hold</button><button type="button" class="button" data-do="resume">Resume</button><button type="button" class="button" data-do="release">Release Stop</button><button type="button" class="button" data-do="reset">Reset</button></div>
      <div class="row"><label>Azimuth <input type="number" class="rig-az" value="30" min="-360" max="360" step="1"></label><label>Slant <input type="number" class="rig-sl" value="40" min="-90" max="90" step="1"></label><button type="button" class="button" data-do="goto">Go to</button></div>
      <div class="row rig-jogs"><div class="rig-jog" role="group" aria-label="Jog"><span></span><button type="button" class="button" data-jog="0,1" aria-label="S+: slant up">S+</button><span></span><button type="button" class="button" data-jog="-1,0" aria-label="A−: azimuth down">A−</button><button type="button" class="button" data-do="jogCancel" aria-label="End the jog">■</button><button type="button" class="button" data-jog="1,0" aria-label="A+: azimuth up">A+</button><span></span><button type="button" class="button" data-jog="0,-1" aria-label="S−: slant down">S−</button><span></span></div>
        <div class="rig-side"><label>by <select class="rig-step"><option>0.1</option><option>1</option><option selected>5</option><option>20</option></select>°</label><button type="button" class="button" data-do="lightOn">LED on</button><button type="button" class="button" data-do="lightOff">LED off</button></div></div>
      <ul class="rig-findings"></ul>
    </section>
    <section class="card rig-capture" aria-labelledby="rig-capture-title">
      <h2 id="rig-capture-title">Capture</h2>
      <div class="row"><label>Camera <select class="rig-camera"><option value="sim">Simulated camera</option><option value="webcam">Camera of this computer</option><option value="folder">Images in a watched folder</option><option value="files">Images chosen for each light</option></select></label></div>
      <div class="rig-of" data-camera="sim">
        <div class="row"><label>Object <select class="rig-object"><option value="blob:7">Blob</option><option value="sphere">Sphere</option><option value="bowl">Bowl</option></select></label>
          <label><input type="checkbox" class="rig-ball"> mirror sphere beside it</label><label><input type="checkbox" class="rig-askew"> arm stands askew</label></div>
      </div>
      <div class="rig-of" data-camera="webcam" hidden>
        <div class="row"><select class="rig-device" aria-label="Camera device"><option value="">Any camera</option></select><button type="button" class="button rig-open-camera">Open camera</button><label>pictures averaged <input type="number" class="rig-average" value="4" min="1" max="64"></label></div>
        <div class="rig-video"></div>
        <p class="note rig-locks">A webcam is not linear: its pictures are taken as sRGB. Normals from it are rough.</p>
      </div>
      <div class="rig-of" data-camera="folder files" hidden>
        <div class="row"><button type="button" class="button rig-watch">Choose the folder…</button><label>black <input type="number" class="rig-black" value="0" min="0" max="65535"></label><label>white <input type="number" class="rig-white" placeholder="largest" min="1" max="65535"></label></div>
        <p class="note">Linear PNG or TIFF of 8 or 16 bits. White is the code where it saturates: 4095 for 12 bits.</p>
      </div>
      <div class="rig-real" hidden>
        <div class="row"><button type="button" class="button rig-look">Take a picture</button><label><input type="checkbox" class="rig-mirror"> mirror sphere beside the object</label><label>Name <input type="text" class="rig-name" value="object" size="12"></label></div>
      </div>
      <div class="row"><label>Planner <select class="rig-planner"></select></label><label>Lights <input type="number" class="rig-lights" value="10" min="3" max="100"></label><label>Solver <select class="rig-solver"></select></label><label>Seed <input type="number" class="rig-seed" value="1" min="0" max="4294967295"></label></div>
      <p class="note rig-withheld" hidden></p>
      <div class="row"><label>Stop at predicted error below, ° <input type="number" class="rig-stop-at" min="0.1" max="89" step="any" placeholder="never"></label></div>
      <details class="rig-more"><summary>Exposure and travel</summary>
        <div class="row"><label>Exposures, ms <input type="text" class="rig-exposures" value="1, 3.2, 10" size="12"></label><label>settle, s <input type="number" class="rig-settle" value="0.3" min="0" max="30" step="0.1"></label><label>LED <input type="number" class="rig-brightness" value="800" min="1" max="100000"></label></div>
        <div class="row"><label>largest slant, ° <input type="number" class="rig-reach" value="75" min="1" max="90"></label><label>prefer nearby lights, up to ° <input type="number" class="rig-nearby" value="0" min="0" max="30"></label></div>
        <div class="row"><label><input type="checkbox" class="rig-dark"> dark frame</label><label><input type="checkbox" class="rig-shutter"> trigger by coolant output</label><label><input type="checkbox" class="rig-homing" checked> home when needed</label></div>
      </details>
      <div class="row"><button type="button" class="button primary rig-auto">Capture</button><button type="button" class="button rig-next">One light</button><button type="button" class="button rig-pause" disabled>Pause</button><button type="button" class="button rig-continue" hidden>Continue</button><button type="button" class="button rig-discard" hidden>Discard it</button></div>
      <p class="rig-progress" role="status">The session is stored in this browser as it goes.</p>
      <p class="rig-ask" hidden><button type="button" class="button primary rig-give">Choose the images</button></p>
      <div class="row"><button type="button" class="button small rig-folder" title="An empty one, or one with a session to continue or to look at">Save to a folder…</button><button type="button" class="button small rig-no-folder" hidden>Not to a folder</button><button type="button" class="button small rig-zip">Download zip</button></div>
    </section>
    <section class="card rig-seen" aria-labelledby="rig-seen-title">
      <h2 id="rig-seen-title">Images and normals</h2>
      <div class="rig-maps"><figure><canvas class="rig-photo" role="img" aria-label="Last image" width="8" height="8"></canvas><figcaption>Last image</figcaption></figure><figure><canvas class="rig-normals" role="img" aria-label="Normals" width="8" height="8"></canvas><figcaption class="rig-error">Normals</figcaption></figure><figure><canvas class="rig-relit" role="img" aria-label="Relit" width="8" height="8"></canvas><figcaption>Relit</figcaption></figure></div>
      <div class="row rig-relight"><label>Light azimuth <input type="range" class="rig-rel-az" min="-180" max="180" value="40"></label><label>slant <input type="range" class="rig-rel-sl" min="0" max="85" value="45"></label></div>
      <p class="rig-budget note"></p>
      <div class="rig-fit" hidden><div class="row"><button type="button" class="button small rig-fit-arm">Fit how the arm stands</button><button type="button" class="button small rig-unfit">Forget the fit</button></div><p class="rig-fitted note" role="status">Measured by the mirror sphere: these directions go into the normals.</p></div>
      <div class="rig-table" tabindex="0" role="region" aria-label="Lights taken"></div>
      <ul class="rig-notes note"></ul>
    </section>
    <section class="card rig-log" aria-labelledby="rig-log-title">
      <div class="head"><h2 id="rig-log-title">Console</h2><button type="button" class="button small rig-copy">Copy</button></div>
      <div class="rig-lines" tabindex="0" role="log" aria-label="Lines sent and received"></div>
      <form class="row rig-type"><label>Line <input type="text" class="rig-line" autocomplete="off" spellcheck="false" size="28" placeholder="$$"></label><button class="button">Send</button></form>
    </section>
    <dialog aria-labelledby="rig-help-title"><h2 id="rig-help-title">No port chosen</h2><p class="rig-help-text"></p><ul>
      <li>Is the cable a data cable? Many only charge.</li>
      <li>Boards with a CH340 or CP210x chip need its driver on Windows and older macOS.</li>
      <li>On Linux your user must be in the group <code>dialout</code>: <code>sudo usermod -aG dialout $USER</code>, then log in again.</li>
      <li>Close other programs that use the board: Arduino IDE, serial monitors, other tabs.</li>
      <li>The board must run stock Grbl 1.1 at 115200 baud.</li></ul>
      <form method="dialog" class="row"><button class="button primary">Close</button></form></dialog>`;
