// Writes the selections of this folder, and the pixels that ImageJ 1.53t fills in them, as bitmaps of 64 x 48 pixels:
// javac -cp ij.jar Make.java && java -Djava.awt.headless=true -cp ij.jar:. Make
import ij.gui.*;
import ij.io.*;
import ij.process.*;
import java.io.*;
import java.util.zip.*;

public class Make {
    static final int W = 64, H = 48;

    static void save(Roi roi, String name) throws Exception {
        roi.setName(name);
        roi.setProperty("reason", "stain of " + name);
        roi.setProperty("author", "A. Author");
        RoiEncoder.save(roi, name + ".roi");
        ByteProcessor image = new ByteProcessor(W, H);
        image.setValue(255);
        image.setRoi(new RoiDecoder(name + ".roi").getRoi());
        image.fill(image.getMask());
        try (FileOutputStream out = new FileOutputStream(name + ".pbm")) {
            out.write(("P4 " + W + " " + H + "\n").getBytes());
            for (int y = 0; y < H; y++)
                for (int at = 0; at < W; at += 8) {
                    int bits = 0;
                    for (int k = 0; k < 8; k++) bits = 2 * bits + (image.get(at + k, y) != 0 ? 1 : 0);
                    out.write(bits);
                }
        }
    }

    public static void main(String[] none) throws Exception {
        int[] x = {5, 30, 41, 22, 8}, y = {4, 2, 19, 33, 25};
        float[] fineX = {5.3f, 30.7f, 41.2f, 22.5f, 8.1f}, fineY = {4.4f, 2.6f, 19.5f, 33.25f, 25.8f};
        save(new PolygonRoi(x, y, 5, Roi.POLYGON), "polygon");
        save(new PolygonRoi(fineX, fineY, Roi.POLYGON), "polygon-fine");
        int[] handX = new int[60], handY = new int[60];
        for (int k = 0; k < 60; k++) {
            double t = 2 * Math.PI * k / 60, far = 12 + 4 * Math.sin(5 * t) + 2 * Math.cos(3 * t);
            handX[k] = (int) Math.round(30 + far * Math.cos(t));
            handY[k] = (int) Math.round(24 + far * Math.sin(t));
        }
        PolygonRoi hand = new PolygonRoi(handX, handY, 60, Roi.FREEROI);
        save((PolygonRoi) hand.clone(), "freehand");
        ByteProcessor drawn = new ByteProcessor(W, H);
        drawn.setValue(255);
        drawn.fillOval(10, 6, 30, 21);
        drawn.setValue(0);
        drawn.fillRect(20, 0, 4, 12);
        Wand wand = new Wand(drawn);
        wand.autoOutline(30, 20, 255, 255);
        save(new PolygonRoi(wand.xpoints, wand.ypoints, wand.npoints, Roi.TRACED_ROI), "traced");
        save(new OvalRoi(11, 5, 33, 27), "oval");
        save(new EllipseRoi(8.5, 10.2, 50.1, 35.7, 0.55), "ellipse");
        save(new RotatedRectRoi(10, 10, 45, 30, 15), "rotated");
        save(new ShapeRoi(new OvalRoi(5, 5, 25, 25)).or(new ShapeRoi(new Roi(40, 20, 15, 20))), "composite-two");
        save(new ShapeRoi(new Roi(5, 5, 40, 30)).not(new ShapeRoi(new Roi(15, 12, 12, 10))), "composite-hole");
        save(new ShapeRoi(hand).or(new ShapeRoi(new Roi(20, 20, 30, 20))), "composite-joined");
        Roi rounded = new Roi(7, 9, 31, 17);
        rounded.setCornerDiameter(8);
        save(rounded, "rounded");
        PolygonRoi spline = new PolygonRoi(x, y, 5, Roi.POLYGON);
        spline.fitSpline();
        save(spline, "spline");
        try (ZipOutputStream archive = new ZipOutputStream(new FileOutputStream("RoiSet.zip"))) {
            for (String name : new String[] {"polygon", "freehand", "composite-hole"}) {
                ZipEntry entry = new ZipEntry(name + ".roi");
                entry.setTime(0);
                archive.putNextEntry(entry);
                DataOutputStream out = new DataOutputStream(new BufferedOutputStream(archive));
                new RoiEncoder(out).write(new RoiDecoder(name + ".roi").getRoi());
                out.flush();
            }
        }
        System.exit(0);
    }
}
